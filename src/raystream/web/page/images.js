// Images, sample after sample: each dispatch traces one ray of each pixel. As
// raystream/graphics/rendering/compute_bands.py.

import {dispatchSize} from "./device.js";
import {PageError} from "./pack.js";
import {paramsOf} from "./queries.js";
import {gatherArrays, inTextures} from "./shaders.js";
import {localEye, viewNumbers} from "./view_uniform.js";

const GROUP_SIZE = 64, PIXEL_BYTES = 96, ROW_BYTES = 48;
const LAYOUT = ["uniform", "scatter", "scatter"];
const SHADING_GROUP = 1, TREE_GROUP = 2;
const MOST_DISPATCHES = 8, FIRST_ROOM = 2, MOST_ROOM = 128;
const LIGHT_COLUMNS = 15, LIGHT_REST = 12;

/** Words of the uniform Shading. */
const AT = {firstPixel: 48, sample: 49, pixelCount: 51, room: 54};

/** What the image shaders read of a scene, besides its structure. */
export function surfacesOf({arrays}, corners, lights) {
  return {
    corners, faces: arrays["surface 1"], vertices: arrays["surface 2"],
    material_ids: arrays["surface 3"], materials: arrays["surface 4"],
    texels: arrays["surface 5"], lights: arrays[lights],
  };
}

export class ImageRenderer {
  static async make(gpu, page, structure, corners, mode) {
    const made = new ImageRenderer(gpu, page, structure, mode);
    await made.prepare(corners);
    return made;
  }

  constructor(gpu, page, structure, mode) {
    this.gpu = gpu;
    this.page = page;
    this.scene = page.manifest;
    this.structure = structure;
    this.mode = this.scene.modes[mode];
    this.words = page.arrays[`shading ${mode}`].slice();
    this.room = FIRST_ROOM;
    this.count = 0;
  }

  async prepare(corners) {
    const {gpu, scene, structure, mode} = this;
    const instead = {};
    if (mode.branches > 1) instead["rendering/one_path.wgsl"] = "rendering/path_rows.wgsl";
    if (/\bcorners: array/.test(structure.plainSource(scene.shaders, []))) {
      instead["rendering/corners.wgsl"] = "rendering/no_corners.wgsl";
    }
    const plain = structure.source(scene.shaders, ["rendering/compute.wgsl", mode.shader],
      {instead: {"nearest_hits.wgsl": "no_hit_rows.wgsl", ...instead}, treeGroup: TREE_GROUP});
    const arrays = surfacesOf(this.page, corners, mode.lights);
    const {kinds, resources} = gpu.textures(gatherArrays(plain, SHADING_GROUP), arrays);
    this.uniform = gpu.buffer("shading", this.words, GPUBufferUsage.UNIFORM);
    this.params = gpu.buffer("params", paramsOf(scene, structure.about, {rayCount: 0, rowSize: 0}),
      GPUBufferUsage.UNIFORM);
    // Bindings that this mode's shaders do not declare stay unused.
    const last = mode.branches > 1 ? 9 : kinds.length;
    this.kinds = Array.from({length: last}, (_, k) => kinds[k] ?? "uniform");
    this.resources = Array.from({length: last}, (_, k) => resources[k] ?? this.uniform);
    this.kinds[0] = "uniform";
    if (mode.branches > 1) this.kinds[8] = "scatter";
    const layouts = [LAYOUT, this.kinds, structure.kinds];
    const source = inTextures(plain, SHADING_GROUP);
    const constants = {...structure.about.constants, ...mode.constants};
    [this.beginning, this.advancing] = await Promise.all(["begin", "trace_and_shade"].map(
      entry => gpu.pipeline({source, entry, layouts, constants})));
    this.counts = gpu.buffer("counts", 16);
    this.lights = arrays.lights;
  }

  /** Set the camera and the size, and forget all samples. */
  begin(camera, size) {
    const count = size[0] * size[1];
    if (count !== this.count) {
      this.records?.destroy();
      this.records = this.gpu.buffer("pixels and their rays", PIXEL_BYTES * count);
      this.count = count;
      this.makeRows();
    }
    this.size = size;
    new Float32Array(this.words.buffer).set(viewNumbers(camera, size, this.scene.frame));
    this.words[AT.firstPixel] = 0;
    this.words[AT.pixelCount] = count;
    this.follow(camera);
    this.dispatch = dispatchSize(count, GROUP_SIZE);
    const {rowSize} = this.dispatch;
    this.gpu.write(this.params,
      paramsOf(this.scene, this.structure.about, {rayCount: count, rowSize}));
  }

  /** Move the light at the eye along with it. */
  follow(camera) {
    const row = this.mode.headlight;
    if (row < 0) return;
    const eye = localEye(camera, this.scene.frame);
    eye.forEach((value, axis) => {
      this.lights[LIGHT_COLUMNS * row + axis] = value;
      this.lights[LIGHT_COLUMNS * row + LIGHT_REST + axis] = value - Math.fround(value);
    });
    this.resources[7].destroy();
    this.resources[7] = this.gpu.texture("lights", this.lights, "f32");
  }

  makeRows() {
    if (this.mode.branches === 1) return;
    this.resources[8] = this.gpu.buffer("paths behind glass", this.rowBytes() * 2);
  }

  rowBytes() {
    return this.count * this.room * ROW_BYTES;
  }

  /** Room for twice as many paths of each pixel, after the same ones as before. */
  grow(encoder) {
    if (this.room * 2 > MOST_ROOM) {
      throw new PageError(`A pixel has more than ${MOST_ROOM} paths at once behind glass.`);
    }
    const [before, bytes] = [this.resources[8], this.rowBytes()];
    this.room *= 2;
    this.makeRows();
    for (const half of [0, 1]) {
      encoder.copyBufferToBuffer(before, half * bytes, this.resources[8],
        half * this.rowBytes(), bytes);
    }
    this.words[AT.room] = this.room;
    this.gpu.write(this.uniform, this.words);
  }

  /** Trace one sample of every pixel; its light is in the last vector of each record. */
  async trace(sample) {
    this.words[AT.sample] = sample;
    this.words[AT.room] = this.mode.branches > 1 ? this.room : 1;
    this.gpu.write(this.uniform, this.words);
    await this.submit([this.beginning], false);
    let dispatches = 1, rays = 0;
    for (;;) {
      const [active, stuck, endless, cut] = await this.submit(
        Array(dispatches).fill(this.advancing), true);
      rays += dispatches;
      if (endless || cut) {
        throw new PageError(`Searches in ${this.structure.name} did not end on this GPU.`);
      }
      if (stuck) {
        const encoder = this.gpu.device.createCommandEncoder();
        this.grow(encoder);
        this.gpu.device.queue.submit([encoder.finish()]);
      } else if (!active) return rays;
      dispatches = Math.min(2 * dispatches, MOST_DISPATCHES);
    }
  }

  async submit(pipelines, reads) {
    const {gpu} = this;
    const groups = [
      gpu.bind(LAYOUT, [this.params, this.records, this.counts]),
      gpu.bind(this.kinds, [this.uniform, ...this.resources.slice(1)]),
      gpu.bind(this.structure.kinds, this.structure.resources),
    ];
    const encoder = gpu.device.createCommandEncoder();
    encoder.clearBuffer(this.counts);
    for (const pipeline of pipelines) {
      encoder.clearBuffer(this.counts, 0, 8);
      const pass = encoder.beginComputePass();
      pass.setPipeline(pipeline);
      groups.forEach((group, number) => pass.setBindGroup(number, group));
      pass.dispatchWorkgroups(this.dispatch.columns, this.dispatch.rows);
      pass.end();
    }
    gpu.device.queue.submit([encoder.finish()]);
    return reads ? new Uint32Array(await gpu.read(this.counts, 16)) : null;
  }

  /** The light of each pixel, three numbers each, of the last sample. */
  async light() {
    const vectors = new Float32Array(
      await this.gpu.read(this.records, 16 * this.count, 5 * 16 * this.count));
    return vectors;
  }
}
