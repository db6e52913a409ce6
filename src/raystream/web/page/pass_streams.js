// The streams of the papers' machine: textures with a record per pixel, and the stencil of the states
// of their rays. As raystream/graphics/streams and graphics/multipass/ray_loop.py.

import {PageError} from "./pack.js";

/** Streams that eye rays and shading write, and those that a traversal does, as render targets. */
const SHADING_STREAMS = ["state", "origins", "directions", "pixels", "weights", "paths", "light"];
const SEARCH_STREAMS = ["state", "found", "place", "span"];
const FLOATS = ["found", "span", "origins", "directions", "light"];

/** The streams at the bindings of both layouts, after the uniform. */
const READ_BY_SHADING = [
  "origins", "directions", "pixels", "state", "found", "weights", "light", "paths",
];
const READ_BY_SEARCHES = ["origins", "directions", "pixels", ...SEARCH_STREAMS];

export const TEXEL_BYTES = 16;
const COLUMNS = 16; // widths are multiples: such rows can be copied without padding

const formatOf = name => (FLOATS.includes(name) ? "rgba32float" : "rgba32uint");
const kindOf = name => (FLOATS.includes(name) ? "unfilterable-float" : "uint");

/** What a group of programs writes, and the layout of its first bind group. */
export const SHADING = {
  number: 0, writes: SHADING_STREAMS, reads: READ_BY_SHADING,
  layout: ["uniform", ...READ_BY_SHADING.map(kindOf)],
};
export const SEARCH = {
  number: 1, writes: SEARCH_STREAMS, reads: READ_BY_SEARCHES,
  layout: ["uniform", ...READ_BY_SEARCHES.map(kindOf)],
};

/** Why a GPU cannot run passes, or null. */
export function whyNoPasses({limits}) {
  const {length} = SHADING_STREAMS;
  const {maxColorAttachments: most, maxColorAttachmentBytesPerSample: bytes} = limits;
  if (most >= length && bytes >= length * TEXEL_BYTES) return null;
  return `Passes write ${length} textures at once, ${length * TEXEL_BYTES} bytes for each pixel; this `
    + `GPU can write ${Math.min(most, Math.floor(bytes / TEXEL_BYTES))}.`;
}

export class Streams {
  constructor(gpu, count) {
    this.gpu = gpu;
    this.count = count;
    this.width = Math.ceil(Math.sqrt(count) / COLUMNS) * COLUMNS;
    this.height = Math.ceil(count / this.width);
    if (this.width > gpu.limits.maxTextureDimension2D) {
      throw new PageError(`${count.toLocaleString()} pixels are too many for a texture.`);
    }
    const names = [...new Set([...SHADING_STREAMS, ...SEARCH_STREAMS])];
    const all = prefix => Object.fromEntries(
      names.map(name => [name, this.texture(prefix + name, formatOf(name))]));
    // A pass may not read what it writes.
    this.streams = all("");
    this.scratch = all("scratch ");
    this.stencil = this.texture("stencil", "stencil8");
    this.states = this.stencil.createView({aspect: "stencil-only"});
  }

  texture(label, format) {
    const {RENDER_ATTACHMENT, TEXTURE_BINDING, COPY_SRC} = GPUTextureUsage;
    return this.gpu.device.createTexture({
      label, size: [this.width, this.height], format,
      usage: RENDER_ATTACHMENT | TEXTURE_BINDING | COPY_SRC,
    });
  }

  destroy() {
    const all = [...Object.values(this.streams), ...Object.values(this.scratch), this.stencil];
    all.forEach(one => one.destroy());
  }

  /** The first bind group of a group of programs: with the streams, or their scratch textures. */
  bind(group, params, isScratch) {
    const from = isScratch ? this.scratch : this.streams;
    return this.gpu.bind(group.layout, [params, ...group.reads.map(name => from[name])]);
  }

  /**
   * Begin a render pass over all records. `stencil` is "read", "load" or "clear"; `times` where to
   * write timestamps.
   */
  begin(encoder, group, {isScratch = false, stencil = "load", times} = {}) {
    const to = isScratch ? this.scratch : this.streams;
    const loadOp = stencil === "clear" ? "clear" : "load";
    const states = {view: this.stencil.createView()};
    if (stencil === "read") states.stencilReadOnly = true;
    else Object.assign(states, {stencilLoadOp: loadOp, stencilStoreOp: "store", stencilClearValue: 0});
    return encoder.beginRenderPass({
      colorAttachments: group.writes.map(name => (
        {view: to[name].createView(), loadOp, storeOp: "store"})),
      depthStencilAttachment: states, timestampWrites: times,
    });
  }

  /** Copy the light of all pixels to a buffer. */
  copyLight(encoder, buffer, offset) {
    encoder.copyTextureToBuffer(
      {texture: this.streams.light},
      {buffer, offset, bytesPerRow: TEXEL_BYTES * this.width},
      [this.width, this.height]);
  }

  /** The records of a stream, once the GPU is done: four words each. */
  async read(name) {
    const {gpu, count, width, height} = this;
    const buffer = gpu.buffer(`copy of ${name}`, TEXEL_BYTES * width * height);
    const encoder = gpu.device.createCommandEncoder();
    encoder.copyTextureToBuffer({texture: this.streams[name]},
      {buffer, bytesPerRow: TEXEL_BYTES * width}, [width, height]);
    gpu.device.queue.submit([encoder.finish()]);
    const content = await gpu.read(buffer, TEXEL_BYTES * count);
    buffer.destroy();
    return FLOATS.includes(name) ? new Float32Array(content) : new Uint32Array(content);
  }
}

/** The stencil test: selects the records in one state, or all, and sets their next one. */
function stencilOf(state, next) {
  // The test uses the reference, so the bits in which both states differ are inverted.
  const [passOp, mask] = next === null ? ["keep", 0]
    : state === null ? ["replace", 0xff] : ["invert", state ^ next];
  const face = {compare: state === null ? "always" : "equal", passOp};
  return {
    format: "stencil8", stencilFront: face, stencilBack: face,
    stencilReadMask: 0xff, stencilWriteMask: mask,
  };
}

/**
 * A draw over all records of a group: {group, source, entry, layouts, constants}, the `state` of the
 * records (null for all), the `next` that it gives them (null to keep it), the streams that it
 * `writes`, and the number of its `kernel`. `cover` is the source of the vertex shader.
 */
export async function drawOf(gpu, cover, {state = null, next = null, ...program}) {
  const {group, source, entry, layouts, constants = {}, writes = [], kernel = 0} = program;
  const pipeline = await gpu.device.createRenderPipelineAsync({
    layout: gpu.pipelineLayout([group.layout, ...layouts]),
    vertex: {module: gpu.module(cover), entryPoint: "cover"},
    depthStencil: stencilOf(state, next),
    fragment: {
      module: gpu.module(source), entryPoint: entry, constants,
      targets: group.writes.map(name => (
        {format: formatOf(name), writeMask: writes.includes(name) ? GPUColorWrite.ALL : 0})),
    },
  });
  return {pipeline, reference: state ?? next ?? 0, kernel, group};
}
