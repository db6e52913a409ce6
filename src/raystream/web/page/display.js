// Adds up the light of samples, and shows their mean on the canvas.

import {shaderSource} from "./shaders.js";

const EXPOSURE_AT = 12; // bytes, in the uniform of picture.wgsl
const KINDS = ["uniform", "gather", "scatter"];

export class Display {
  static async make(gpu, shaders, canvas) {
    const made = new Display(gpu, canvas);
    await made.prepare(shaders);
    return made;
  }

  constructor(gpu, canvas) {
    this.gpu = gpu;
    this.canvas = canvas;
    this.context = canvas.getContext("webgpu");
    this.format = navigator.gpu.getPreferredCanvasFormat();
    this.band = gpu.buffer("band", 16, GPUBufferUsage.UNIFORM);
    this.picture = gpu.buffer("picture", 16, GPUBufferUsage.UNIFORM);
    this.size = [0, 0];
    this.expose(1);
  }

  async prepare(shaders) {
    const {gpu} = this;
    this.adding = await gpu.pipeline({
      source: shaderSource(shaders, ["page/accumulate.wgsl"]),
      entry: "accumulate", layouts: [KINDS], constants: {},
    });
    this.showing = await this.pipeline(shaderSource(shaders, ["page/show.wgsl"]), "show");
  }

  /** Show this on the canvas, instead of what another GPU draws. */
  configure() {
    this.context.configure({device: this.gpu.device, format: this.format});
  }

  /** A pipeline that draws the whole canvas: source and entry point of a fragment shader. */
  pipeline(code, entryPoint) {
    const {device} = this.gpu;
    const module = device.createShaderModule({code});
    return device.createRenderPipelineAsync({
      layout: "auto", vertex: {module, entryPoint: "cover"},
      fragment: {module, entryPoint, targets: [{format: this.format}]},
    });
  }

  /** Set the factor on the light of images. */
  expose(exposure) {
    this.gpu.write(this.picture, Float32Array.of(exposure), EXPOSURE_AT);
  }

  /** Begin an image: width and height in pixels. */
  begin(size) {
    if (size.join() === this.size.join()) return;
    this.sums?.destroy();
    this.sums = this.gpu.buffer("sums of samples", 16 * size[0] * size[1]);
    this.size = size;
    this.gpu.write(this.picture, Uint32Array.of(...size));
  }

  /** Add a sample of a band's pixels, from a first one on; sample 0 replaces what was there. */
  add({count, records, dispatch: {columns, rows, rowSize}}, sample, first) {
    const {gpu} = this;
    gpu.write(this.band, Uint32Array.of(count, rowSize, sample, first));
    const encoder = gpu.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.adding);
    pass.setBindGroup(0, gpu.bind(KINDS, [this.band, records, this.sums]));
    pass.dispatchWorkgroups(columns, rows);
    pass.end();
    gpu.device.queue.submit([encoder.finish()]);
  }

  show() {
    return this.present(this.showing, [this.picture, this.sums].map(
      (buffer, binding) => [binding, {buffer}]));
  }

  /** Draw the canvas as `draw` does, and wait until the GPU is done. */
  async present(pipeline, resources) {
    const {device} = this.gpu;
    const encoder = device.createCommandEncoder();
    this.draw(encoder, pipeline, resources);
    device.queue.submit([encoder.finish()]);
    await device.queue.onSubmittedWorkDone();
  }

  /** Cover the canvas by a pipeline with resources, pairs of binding and resource. */
  draw(encoder, pipeline, resources) {
    const {gpu, canvas, size: [width, height]} = this;
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const view = this.context.getCurrentTexture().createView();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{view, loadOp: "clear", storeOp: "store"}],
    });
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, gpu.device.createBindGroup({
      layout: pipeline.getBindGroupLayout(0),
      entries: resources.map(([binding, resource]) => ({binding, resource})),
    }));
    pass.draw(3);
    pass.end();
  }
}
