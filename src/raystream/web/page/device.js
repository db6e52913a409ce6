// The visitor's GPU: opens it, and makes buffers, textures, bind groups and pipelines.

import {PageError} from "./pack.js";
import {TEXELS, TEXTURE_WIDTH} from "./shaders.js";
import {missingWebGpu} from "./webgpu.js";

const KINDS = {
  uniform: {buffer: {type: "uniform"}},
  gather: {buffer: {type: "read-only-storage"}},
  scatter: {buffer: {type: "storage"}},
};

/** Limits that are asked for where the adapter offers more than the least. */
const LIMITS = [
  "maxStorageBuffersPerShaderStage", "maxStorageBufferBindingSize", "maxBufferSize",
  "maxTextureDimension2D", "maxColorAttachments", "maxColorAttachmentBytesPerSample",
];

/** Features that are asked for where the adapter has them. */
const FEATURES = ["timestamp-query"];

/** Milliseconds that an error may precede the report that the GPU is lost. */
const REPORTED_WITHIN = 500;

/** Pixels of the first dispatch; seconds that one should take; largest growth to the next. */
const FIRST = 1 << 10, SECONDS = 0.07, GROWTH = 8;

export class Gpu {
  static async open() {
    const missing = missingWebGpu();
    if (missing) throw new PageError(missing);
    const adapter = await navigator.gpu.requestAdapter({powerPreference: "high-performance"});
    if (!adapter) throw new PageError("No GPU was found.");
    const requiredLimits = Object.fromEntries(LIMITS.map(name => [name, adapter.limits[name]]));
    const requiredFeatures = FEATURES.filter(name => adapter.features.has(name));
    return new Gpu(adapter, await adapter.requestDevice({requiredFeatures, requiredLimits}));
  }

  constructor(adapter, device) {
    this.device = device;
    this.name = adapter.info.description || adapter.info.architecture || adapter.info.vendor;
    this.modules = new Map();
    this.layouts = new Map();
    this.kept = new Map();
    this.isLost = false;
    this.loss = device.lost.then(() => { this.isLost = true; });
  }

  get limits() {
    return this.device.limits;
  }

  /** Most bytes of a buffer. */
  get mostBytes() {
    return Math.min(this.limits.maxStorageBufferBindingSize, this.limits.maxBufferSize);
  }

  /** Whether the GPU is lost: after an error it may take a while to be reported. */
  async wasLost() {
    await Promise.race([this.loss, new Promise(done => setTimeout(done, REPORTED_WITHIN))]);
    return this.isLost;
  }

  /** A buffer with the content of an array, or room for a number of bytes. */
  buffer(name, content, usage = GPUBufferUsage.STORAGE) {
    const size = typeof content === "number" ? content : content.byteLength;
    const room = Math.max(Math.ceil(size / 16) * 16, 64);
    if (room > this.mostBytes) {
      throw new PageError(
        `${name} would take ${room.toLocaleString()} bytes, but this GPU allows `
        + `${this.mostBytes.toLocaleString()} in a buffer.`);
    }
    const made = this.device.createBuffer({
      label: name, size: room, usage: usage | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC,
    });
    if (typeof content !== "number" && size) this.write(made, content);
    return made;
  }

  write(buffer, content, at = 0) {
    this.device.queue.writeBuffer(buffer, at, content.buffer, content.byteOffset,
      content.byteLength);
  }

  /** The content of a buffer, once the GPU is done. */
  async read(buffer, bytes, at = 0) {
    const copy = this.device.createBuffer({
      size: bytes, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST,
    });
    const encoder = this.device.createCommandEncoder();
    encoder.copyBufferToBuffer(buffer, at, copy, 0, bytes);
    this.device.queue.submit([encoder.finish()]);
    await copy.mapAsync(GPUMapMode.READ);
    const content = copy.getMappedRange().slice(0);
    copy.destroy();
    return content;
  }

  /** A texture that holds an array, in rows of TEXTURE_WIDTH texels. */
  texture(name, array, element) {
    const {format, words} = TEXELS[element];
    const row = TEXTURE_WIDTH * words;
    const height = Math.max(Math.ceil(array.length / row), 1);
    if (height > this.limits.maxTextureDimension2D) {
      throw new PageError(`${name} needs a texture of ${height.toLocaleString()} rows, but this GPU `
        + `allows ${this.limits.maxTextureDimension2D.toLocaleString()}.`);
    }
    const texture = this.device.createTexture({
      label: name, size: [TEXTURE_WIDTH, height], format,
      usage: GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST,
    });
    this.fill(texture, array, element);
    return texture;
  }

  /** Copy an array to a texture that was made for one of this length. */
  fill(texture, array, element) {
    const row = 4 * TEXTURE_WIDTH * TEXELS[element].words;
    const padded = new Uint8Array(row * texture.height);
    padded.set(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
    this.device.queue.writeTexture({texture}, padded, {bytesPerRow: row},
      [TEXTURE_WIDTH, texture.height]);
  }

  /** A resource of a kind for an array, made once: structures share arrays. */
  shared(kind, array, makeOne) {
    return cached(cached(this.kept, kind, () => new Map()), array, makeOne);
  }

  /** The kind of a bind group's entry that is a texture. */
  kindOf(element) {
    return TEXELS[element].sampleType;
  }

  /** Layout of a bind group whose entries are kinds of buffers, or sample types of textures. */
  layout(kinds) {
    const key = kinds.join();
    if (!this.layouts.has(key)) {
      const entries = kinds.map((kind, binding) => ({
        binding, visibility: GPUShaderStage.COMPUTE | GPUShaderStage.FRAGMENT,
        ...(KINDS[kind] ?? {texture: {sampleType: kind}}),
      }));
      this.layouts.set(key, this.device.createBindGroupLayout({entries}));
    }
    return this.layouts.get(key);
  }

  bind(kinds, resources) {
    const entries = resources.map((one, binding) => ({
      binding,
      resource: one instanceof GPUBuffer ? {buffer: one}
        : one instanceof GPUTexture ? one.createView() : one,
    }));
    return this.device.createBindGroup({layout: this.layout(kinds), entries});
  }

  /** A compute pipeline: {source, entry, layouts, constants}. */
  async pipeline({source, entry, layouts, constants}) {
    return this.device.createComputePipelineAsync({
      layout: this.pipelineLayout(layouts),
      compute: {module: this.module(source), entryPoint: entry, constants},
    });
  }

  module(source) {
    if (!this.modules.has(source)) {
      this.modules.set(source, this.device.createShaderModule({code: source}));
    }
    return this.modules.get(source);
  }

  pipelineLayout(layouts) {
    const groups = layouts.map(kinds => this.layout(kinds));
    return this.device.createPipelineLayout({bindGroupLayouts: groups});
  }

  /** Arrays as textures, for the declarations of `gatherArrays`: {kinds, resources}. */
  textures(declared, arrays) {
    const kinds = [], resources = [];
    for (const {binding, name, element} of declared) {
      kinds[binding] = this.kindOf(element);
      resources[binding] = this.shared(element, arrays[name],
        () => this.texture(name, arrays[name], element));
    }
    return {kinds, resources};
  }
}

/** The value or promise of a key, made once; again after a promise was rejected. */
export function cached(map, key, makeOne) {
  if (!map.has(key)) {
    const made = makeOne();
    map.set(key, made);
    if (made instanceof Promise) made.catch(() => map.delete(key));
  }
  return map.get(key);
}

/** Columns and rows of workgroups for a number of invocations, and invocations in a row. */
export function dispatchSize(count, size, most = 65535) {
  const groups = Math.ceil(count / size);
  const columns = Math.min(groups, most);
  return {columns, rows: Math.ceil(groups / columns), rowSize: columns * size};
}

/** The number of pixels of a dispatch, so that none takes long: as raystream/graphics/dispatch_size.py. */
export class DispatchSize {
  constructor(most) {
    this.most = most;
    this.size = Math.min(FIRST, most);
  }

  /** Take in the time of a dispatch. */
  took(count, seconds) {
    if (count < this.size && seconds <= SECONDS) return; // the last ones: too few to extrapolate
    const right = Math.floor(count * SECONDS / Math.max(seconds, 1e-9));
    this.size = Math.max(Math.min(right, this.size * GROWTH, this.most), 1);
  }
}
