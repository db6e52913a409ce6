// Heat maps: counts of work per pixel in false colours, and their legend.

import {byId} from "./elements.js";
import {shaderSource} from "./shaders.js";

const KINDS = ["uniform", "gather", "scatter"];
const MODE = "heatmap", GROUP = 8;
const CHANNEL_AT = 8; // bytes before the channel in the uniform of picture.wgsl

/** Choices of modes: each heat map is one. */
export function modeChoices({modes, structures}) {
  const maps = Object.keys(Object.values(structures)[0].counts);
  return Object.keys(modes).flatMap(
    mode => (mode === MODE ? maps.map(what => [`${MODE} ${what}`, `heat map: ${what}`]) : [[mode, mode]]));
}

/** The mode that is rendered for a choice, and what it shows of its counts, if any. */
export const partsOf = choice => choice.split(" ");

export class HeatmapDisplay {
  static async make(gpu, {manifest, arrays}, display) {
    const made = new HeatmapDisplay(gpu, display, arrays.ramp);
    const source = shaderSource(manifest.shaders, ["page/show_counts.wgsl"]);
    [made.finding, made.showing] = await Promise.all([
      gpu.pipeline({source, entry: "find_most", layouts: [KINDS], constants: {}}),
      display.pipeline(source, "show_counts"),
    ]);
    return made;
  }

  constructor(gpu, display, colors) {
    this.gpu = gpu;
    this.display = display;
    this.most = gpu.buffer("largest count", 4);
    this.ramp = gpu.buffer("colours of counts", colors);
    drawRamp(byId("legend-bar"), colors);
  }

  /** Show a channel of the display's sums, and its largest count at the top of the scale. */
  async show({channel, title}) {
    const {gpu, display, most} = this;
    const [width, height] = display.size;
    gpu.write(display.picture, Uint32Array.of(channel), CHANNEL_AT);
    const encoder = gpu.device.createCommandEncoder();
    encoder.clearBuffer(most);
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.finding);
    pass.setBindGroup(0, gpu.bind(KINDS, [display.picture, display.sums, most]));
    pass.dispatchWorkgroups(Math.ceil(width / GROUP), Math.ceil(height / GROUP));
    pass.end();
    const buffers = [display.picture, display.sums, most, this.ramp];
    display.draw(encoder, this.showing, buffers.map((buffer, binding) => [binding, {buffer}]));
    gpu.device.queue.submit([encoder.finish()]);
    const [top] = new Float32Array(await gpu.read(most, 4));
    byId("legend-title").textContent = `${title} per ray`;
    byId("legend-top").textContent = top.toLocaleString(undefined, {maximumFractionDigits: 1});
  }
}

function drawRamp(canvas, colors) {
  canvas.width = colors.length;
  canvas.height = 1;
  const bytes = new Uint8ClampedArray(colors.buffer, colors.byteOffset, colors.byteLength);
  canvas.getContext("2d").putImageData(new ImageData(bytes.slice(), colors.length, 1), 0, 0);
}
