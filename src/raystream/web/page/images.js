// Images, sample after sample, in bands of pixels: each dispatch traces one ray of each pixel of a
// band. As raystream/graphics/rendering/compute_bands.py.

import {DispatchSize, dispatchSize} from "./device.js";
import {GpuClock} from "./gpu_clock.js";
import {PageError} from "./pack.js";
import {checkEnded, paramsOf} from "./queries.js";
import {gatherArrays, inTextures} from "./shaders.js";
import {localEye, viewNumbers} from "./view_uniform.js";

const GROUP_SIZE = 64, PIXEL_BYTES = 96, ROW_BYTES = 48;
const LAYOUT = ["uniform", "scatter", "scatter"];
const SHADING_GROUP = 1, TREE_GROUP = 2, ROWS_BINDING = 8;
const MOST_DISPATCHES = 8, MOST_ROOM = 128;
export const FIRST_ROOM = 2;
const MOST_BYTES = 1 << 28; // of a buffer for the pixels of a band

/** Words of the uniform Shading. */
const AT = {first_pixel: 48, sample: 49, pixel_count: 51, room: 54};

export class ImageRenderer {
  static async make(gpu, page, scene, structure, mode) {
    const made = new ImageRenderer(gpu, page, scene, structure, mode);
    await made.prepare();
    return made;
  }

  constructor(gpu, page, scene, structure, mode) {
    this.gpu = gpu;
    this.manifest = page.manifest;
    this.scene = scene;
    this.structure = structure;
    this.mode = this.manifest.modes[mode];
    this.hasRows = this.mode.branches > 1;
    this.words = page.arrays[`shading ${mode}`].slice();
    this.size = new DispatchSize(Math.floor(this.mostBytes / PIXEL_BYTES));
    this.room = this.hasRows ? FIRST_ROOM : 1;
    this.clock = new GpuClock(gpu);
  }

  get mostBytes() {
    return Math.min(this.gpu.mostBytes, MOST_BYTES);
  }

  async prepare() {
    const {gpu, manifest, structure, mode, hasRows} = this;
    const instead = {"nearest_hits.wgsl": "no_hit_rows.wgsl"};
    if (hasRows) instead["rendering/one_path.wgsl"] = "rendering/path_rows.wgsl";
    if (/\bcorners: array/.test(structure.plainSource(manifest.shaders, []))) {
      instead["rendering/corners.wgsl"] = "rendering/no_corners.wgsl";
    }
    const plain = structure.source(manifest.shaders, ["rendering/compute.wgsl", mode.shader],
      {instead, treeGroup: TREE_GROUP});
    this.uniform = gpu.buffer("shading", this.words, GPUBufferUsage.UNIFORM);
    this.params = gpu.buffer("params", paramsOf(this.manifest, structure.about,
      {rayCount: 0, rowSize: 0}), GPUBufferUsage.UNIFORM);
    this.counts = gpu.buffer("counts", 16);
    this.copied = gpu.buffer("copy of counts", 16 * MOST_DISPATCHES);
    this.bindScene(plain);
    const layouts = [LAYOUT, this.kinds, structure.kinds];
    const source = inTextures(plain, SHADING_GROUP);
    const constants = {...structure.about.constants, ...mode.constants};
    [this.beginning, this.advancing] = await Promise.all(["begin", "trace_and_shade"].map(
      entry => gpu.pipeline({source, entry, layouts, constants})));
  }

  /** Find what a source binds in the group of shading. */
  bindScene(plain) {
    const {gpu, mode, hasRows} = this;
    const declared = gatherArrays(plain, SHADING_GROUP);
    const kinds = [], resources = [];
    for (const one of declared) {
      kinds[one.binding] = gpu.kindOf(one.element);
      resources[one.binding] = this.scene.texture(one, mode);
    }
    // Bindings that this mode's shaders do not declare stay unused.
    const last = hasRows ? ROWS_BINDING + 1 : Math.max(kinds.length, 1);
    this.kinds = Array.from({length: last}, (_, k) => kinds[k] ?? "uniform");
    this.resources = Array.from({length: last}, (_, k) => resources[k] ?? this.uniform);
    if (hasRows) this.kinds[ROWS_BINDING] = "scatter";
  }

  /** The resources of the group of shading. */
  get shadingResources() {
    const resources = [...this.resources];
    if (this.hasRows) resources[ROWS_BINDING] = this.scene.buffer("paths behind glass", 0);
    return resources;
  }

  /** Set the camera and the size of the image. */
  begin(camera, [width, height]) {
    const {frame} = this.manifest;
    if (width * height !== this.pixelCount) this.room = this.hasRows ? FIRST_ROOM : 1;
    this.pixelCount = width * height;
    new Float32Array(this.words.buffer).set(viewNumbers(camera, [width, height], frame));
    this.scene.moveLight(this.mode, localEye(camera, frame));
  }

  setBand(first, count, sample) {
    const {words, room} = this;
    Object.entries({first_pixel: first, sample, pixel_count: count, room}).forEach(
      ([name, value]) => { words[AT[name]] = value; });
    this.gpu.write(this.uniform, words);
  }

  /**
   * Trace one sample of the pixels from a first one on: as many as take a short time. Their light is
   * in the last vectors of their records, until the next call.
   */
  async trace(sample, first) {
    const {gpu, scene} = this;
    if (first === 0) this.clock.restart();
    for (;;) {
      const rows = this.hasRows ? Math.floor(this.mostBytes / this.rowBytes(1)) : Infinity;
      const count = Math.min(this.size.size, rows, this.pixelCount - first);
      this.setBand(first, count, sample);
      const dispatch = dispatchSize(count, GROUP_SIZE, gpu.limits.maxComputeWorkgroupsPerDimension);
      gpu.write(this.params, paramsOf(this.manifest, this.structure.about,
        {rayCount: count, rowSize: dispatch.rowSize}));
      const records = scene.buffer("pixels and their rays", PIXEL_BYTES * count);
      if (this.hasRows) scene.buffer("paths behind glass", this.rowBytes(count));
      if (await this.advance(count, records, dispatch)) return {count, records, dispatch};
    }
  }

  /** Trace all rays of some pixels; false if there is no room for their paths, with more now. */
  async advance(count, records, dispatch) {
    await this.submit([this.beginning], records, dispatch);
    let rays = count; // of the next dispatch
    for (let dispatches = 1;; dispatches = Math.min(2 * dispatches, MOST_DISPATCHES)) {
      const began = performance.now();
      const counts = await this.submit(
        Array(dispatches).fill(this.advancing), records, dispatch, true);
      const actives = Array.from({length: dispatches}, (_, k) => counts[4 * k]);
      const [active, stuck, endless, cut] = counts.subarray(4 * (dispatches - 1));
      this.clock.rays += actives.slice(0, -1).reduce((sum, one) => sum + one, rays);
      rays = active + stuck;
      this.size.took(count, (performance.now() - began) / 1000 / dispatches);
      checkEnded(this.structure, !endless && !cut);
      if (stuck) {
        if (!this.grow(count)) return false;
      } else if (!active) return true;
    }
  }

  rowBytes(count) {
    return 2 * count * this.room * ROW_BYTES;
  }

  /** Room for twice as many paths of each pixel; false if the pixels have to be fewer. */
  grow(count) {
    const before = this.rowBytes(count);
    if (this.room * 2 > MOST_ROOM) {
      throw new PageError(`A pixel has more than ${MOST_ROOM} paths at once behind glass.`);
    }
    this.room *= 2;
    if (this.rowBytes(count) > this.mostBytes) return false;
    this.scene.growHalves("paths behind glass", this.rowBytes(count), before);
    this.gpu.write(this.uniform, Uint32Array.of(this.room), 4 * AT.room);
    return true;
  }

  async submit(pipelines, records, {columns, rows}, isRead = false) {
    const {gpu, structure, clock} = this;
    const groups = [
      gpu.bind(LAYOUT, [this.params, records, this.counts]),
      gpu.bind(this.kinds, this.shadingResources),
      gpu.bind(structure.kinds, structure.resources),
    ];
    const encoder = gpu.device.createCommandEncoder();
    encoder.clearBuffer(this.counts);
    for (const [k, pipeline] of pipelines.entries()) {
      encoder.clearBuffer(this.counts, 0, 8);
      const timestampWrites = clock.writes(k === 0, k === pipelines.length - 1);
      const pass = encoder.beginComputePass({timestampWrites});
      pass.setPipeline(pipeline);
      groups.forEach((group, number) => pass.setBindGroup(number, group));
      pass.dispatchWorkgroups(columns, rows);
      pass.end();
      encoder.copyBufferToBuffer(this.counts, 0, this.copied, 16 * k, 16);
    }
    clock.end(encoder);
    gpu.device.queue.submit([encoder.finish()]);
    if (!isRead) return null;
    const [counts] = await Promise.all([
      gpu.read(this.copied, 16 * pipelines.length), clock.addTime(),
    ]);
    return new Uint32Array(counts);
  }
}
