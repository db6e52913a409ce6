// What all images of a page share on the GPU: the scene's surfaces, and the rays of a band of pixels.

/** Words of a light, and where what rounding leaves of its position is. */
const LIGHT_COLUMNS = 15, LIGHT_REST = 12;

export class SceneOnGpu {
  constructor(gpu, {manifest, arrays}, corners) {
    this.gpu = gpu;
    this.frame = manifest.frame;
    this.arrays = {
      corners, faces: arrays["surface 1"], vertices: arrays["surface 2"],
      material_ids: arrays["surface 3"], materials: arrays["surface 4"],
      texels: arrays["surface 5"],
    };
    this.kept = arrays;
    this.textures = new Map();
    this.buffers = new Map();
    this.streams = null; // of passes
  }

  /** A texture of one of the shaders' arrays; lights are those of a mode. */
  texture({name, element}, mode) {
    const key = name === "lights" ? mode.lights : name;
    if (!this.textures.has(key)) {
      const array = name === "lights" ? this.kept[key] : this.arrays[name];
      this.textures.set(key, this.gpu.texture(key, array, element));
    }
    return this.textures.get(key);
  }

  /** A buffer with room for a number of bytes; a larger one replaces it, without its content. */
  buffer(name, bytes) {
    const before = this.buffers.get(name);
    if (before?.size >= bytes) return before;
    const made = this.gpu.buffer(name, bytes);
    this.buffers.set(name, made);
    before?.destroy();
    return made;
  }

  /** As `buffer`; both halves of the content are moved to the halves of a larger one. */
  growHalves(name, bytes, usedBefore) {
    const before = this.buffers.get(name);
    const made = this.gpu.buffer(name, bytes);
    const encoder = this.gpu.device.createCommandEncoder();
    for (const half of [0, 1]) {
      encoder.copyBufferToBuffer(before, half * usedBefore / 2, made, half * bytes / 2,
        usedBefore / 2);
    }
    this.gpu.device.queue.submit([encoder.finish()]);
    this.buffers.set(name, made);
    before.destroy();
  }

  /** Move the light at the eye of a mode to an eye, given in the local frame. */
  moveLight({lights, headlight}, eye) {
    // Shaders of ambient occlusion read no lights.
    if (headlight < 0 || !this.textures.has(lights)) return;
    const moved = this.kept[lights].slice();
    eye.forEach((value, axis) => {
      moved[LIGHT_COLUMNS * headlight + axis] = value;
      moved[LIGHT_COLUMNS * headlight + LIGHT_REST + axis] = value - Math.fround(value);
    });
    this.gpu.fill(this.textures.get(lights), moved, "f32");
  }
}
