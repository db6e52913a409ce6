// Images by the papers' machine: eye rays, the steps of a traversal and shading are kernels, and each
// pass runs one of them on all rays that wait for it (Purcell 2002, section 3). As
// raystream/graphics/multipass/loop_machine.py and loops.py.

import {dispatchSize} from "./device.js";
import {FIRST_ROOM, ImageRenderer} from "./images.js";
import {PageError} from "./pack.js";
import {Schedule} from "./pass_schedule.js";
import {SEARCH, SHADING, Streams, TEXEL_BYTES, drawOf, whyNoPasses} from "./pass_streams.js";
import {checkEnded, paramsOf} from "./queries.js";
import {inTextures, shaderSource} from "./shaders.js";

/** Most pixels of an image: all are traced together. */
export const MOST_PIXELS_OF_PASSES = 1 << 18;

/** Passes that are encoded before the counts are read: at first, and at most. And most of a sample. */
const FIRST_PASSES = 8, MOST_PASSES = 64, MAX_PASSES = 1 << 20;
const GROUP_SIZE = 64, PIXEL_TEXELS = 6, LIGHT = 5; // as rendering/compute.wgsl
const FIRST_HIT = 0;

export class PassRenderer extends ImageRenderer {
  static async make(gpu, page, scene, structure, mode) {
    const why = whyNoPasses(gpu);
    if (why) throw new PageError(why);
    const made = new PassRenderer(gpu, page, scene, structure, mode);
    await made.prepare();
    return made;
  }

  async prepare() {
    const {gpu, manifest, structure, mode} = this;
    const {states} = manifest.schedule;
    const own = structure.about.passes;
    this.states = states;
    this.kernels = [...own.kernels, {
      name: "shade", entry: "shade", state: states.shading, writes: SHADING.writes,
      next: [...(mode.spawns ? [states.starting] : []), states.done,
        ...(this.hasRows ? [states["no room"]] : [])],
    }];
    this.uniform = gpu.buffer("shading", this.words, GPUBufferUsage.UNIFORM);
    this.params = gpu.buffer("params", paramsOf(manifest, structure.about, {rayCount: 0, rowSize: 0}),
      GPUBufferUsage.UNIFORM);
    // Kernels that run once are encoded only at the edges of a batch.
    this.every = this.kernels.map((_, k) => k);
    this.inner = this.every.slice(mode.spawns ? 0 : 1, mode.spawns ? undefined : -1);
    this.schedule = new Schedule(gpu, manifest,
      {kernels: this.kernels, spawns: mode.spawns, mostPasses: MOST_PASSES});
    await Promise.all([this.schedule.prepare([this.every, this.inner]), this.prepareDraws()]);
  }

  async prepareDraws() {
    const {gpu, manifest: {shaders}, structure, mode, states, hasRows, kernels} = this;
    const own = structure.about.passes;
    const cover = shaderSource(shaders, ["page/show.wgsl"]);
    const plain = shaderSource(shaders,
      ["multipass/loop/eye_rays.wgsl", "multipass/loop/shade.wgsl", mode.shader],
      {instead: hasRows ? {"rendering/one_path.wgsl": "rendering/path_rows.wgsl"} : {}});
    this.bindScene(plain);
    const pixels = {
      group: SHADING, source: inTextures(plain, 1), layouts: [this.kinds],
      constants: mode.constants, writes: SHADING.writes,
    };
    const search = {
      group: SEARCH, layouts: [structure.kinds],
      source: structure.source(shaders, [own.shader], {instead: {
        ...own.instead, "fragment/hit_rows.wgsl": "no_hit_rows.wgsl",
        "fragment/counters.wgsl": "fragment/no_counters.wgsl",
      }}),
      constants: {...structure.about.constants, QUERY: FIRST_HIT, SHADES_ALL: 1},
    };
    const shared = {
      group: SEARCH, layouts: [], source: shaderSource(shaders, ["multipass/commit.wgsl"]),
    };
    const copying = {
      ...pixels, entry: "commit", constants: {},
      source: shaderSource(shaders, ["multipass/loop/commit.wgsl"]),
    };
    const draws = about => drawOf(gpu, cover, about);
    const last = kernels.length - 1;
    const made = await Promise.all([
      draws({...pixels, entry: "eye_rays", next: states.starting}),
      draws({...shared, entry: "resume", state: states["no room"], next: states.shading}),
      ...kernels.map(({entry, state, writes}, kernel) => (
        draws({...(kernel === last ? pixels : search), entry, state, writes, kernel}))),
      ...kernels.map(({state, writes}, kernel) => (
        draws({...(kernel === last ? copying : {...shared, entry: "commit"}), state, writes, kernel}))),
    ]);
    this.eyeRays = made.shift();
    this.resuming = made.shift();
    this.running = made.slice(0, kernels.length);
    this.copying = made.slice(kernels.length);
    this.moving = await Promise.all(kernels.flatMap(({state, next}, kernel) => next.map(to => (
      draws({...shared, entry: "classify", constants: {NEXT: to}, state, next: to, kernel})))));
  }

  begin(camera, size) {
    super.begin(camera, size);
    this.sample = -1; // none is under way
    this.last = null;
    this.passes = new Map([["eye rays", 0], ...this.kernels.map(({name}) => [name, 0])]);
    this.waiting = new Uint32Array(16);
    // One image is traced at a time.
    const {scene, pixelCount} = this;
    if (scene.streams?.count !== pixelCount) {
      scene.streams?.destroy();
      scene.streams = new Streams(this.gpu, pixelCount);
    }
    this.streams = scene.streams;
  }

  /** Rays that wait for a kernel. */
  get activeCount() {
    return this.kernels.reduce((sum, {state}) => sum + this.waiting[state], 0);
  }

  /**
   * Trace a sample of all pixels, or what is left of it; null if `goesOn`, which is called with the
   * counts of each batch of passes, returns false.
   */
  async trace(sample, _, goesOn) {
    if (this.sample !== sample) await this.start(sample);
    for (let length = FIRST_PASSES; this.activeCount; length = Math.min(2 * length, MOST_PASSES)) {
      await this.runPasses(length);
      if (!goesOn(this)) return null;
    }
    return this.finish();
  }

  /** Run one pass; returns what `trace` does if it was the last one of a sample, else null. */
  async step(sample) {
    if (this.sample === sample) await this.runPasses(1);
    else await this.start(sample);
    return this.activeCount ? null : this.finish();
  }

  /** Begin a sample: every pixel gets its eye ray. */
  async start(sample) {
    const {gpu, streams, pixelCount, schedule} = this;
    this.room = this.hasRows ? FIRST_ROOM : 1;
    if (this.hasRows) this.scene.buffer("paths behind glass", this.rowBytes(pixelCount));
    this.setBand(0, pixelCount, sample);
    gpu.write(this.params, paramsOf(this.manifest, this.structure.about,
      {rayCount: pixelCount, rowSize: streams.width}));
    this.clock.restart();
    schedule.begin(streams);
    this.bindAll();
    const encoder = gpu.device.createCommandEncoder();
    const run = streams.begin(encoder, SHADING, {stencil: "clear"});
    this.drawAll(run, SHADING, true, [this.eyeRays]);
    run.end();
    const {waiting} = await schedule.read(encoder);
    this.sample = sample;
    this.sampleCount = 0;
    this.waiting = waiting;
    this.note("eye rays", pixelCount);
  }

  /** Run passes, until no ray is active. */
  async runPasses(length) {
    const {gpu, schedule, clock} = this;
    const encoder = gpu.device.createCommandEncoder();
    schedule.clear(encoder);
    for (let k = 0; k < length; k++) {
      const isEdge = k === 0 || k === length - 1;
      this.encodePass(encoder, isEdge ? this.every : this.inner,
        [clock.writes(k === 0, false), clock.writes(false, k === length - 1)]);
    }
    clock.end(encoder);
    const [{passes, waiting}] = await Promise.all([schedule.read(encoder), clock.addTime()]);
    this.waiting = waiting;
    for (const {kernel, rays} of passes) {
      this.note(this.kernels[kernel].name, rays);
      if (kernel === 0) clock.rays += rays; // each ray is set up once
    }
    this.sampleCount += passes.length;
    if (this.sampleCount > MAX_PASSES) {
      throw new PageError(`Rays are still active after ${this.sampleCount.toLocaleString()} passes.`);
    }
    if (!this.activeCount && waiting[this.states["no room"]]) await this.resume();
  }

  encodePass(encoder, kernels, [first, last]) {
    const {streams, schedule} = this;
    const of = draws => draws.filter(({kernel}) => kernels.includes(kernel));
    schedule.encode(encoder, kernels, first);
    for (const [draws, isCommit] of [[of(this.running), false], [of(this.copying), true]]) {
      for (const group of [SHADING, SEARCH]) {
        const own = draws.filter(one => one.group === group);
        // Rays move to their next states after all streams have been copied.
        const isLast = isCommit && group === SEARCH;
        if (isLast) own.push(...of(this.moving));
        if (!own.length) continue;
        const run = streams.begin(encoder, group,
          isCommit ? {times: isLast ? last : undefined} : {isScratch: true, stencil: "read"});
        this.drawAll(run, group, isCommit, own, schedule);
        run.end();
      }
    }
  }

  drawAll(run, group, isCommit, draws, schedule) {
    this.groups.get(group)[Number(isCommit)].forEach((one, k) => run.setBindGroup(k, one));
    for (const draw of draws) {
      if (schedule) {
        schedule.draw(run, draw);
      } else {
        run.setPipeline(draw.pipeline);
        run.setStencilReference(draw.reference);
        run.draw(3);
      }
    }
  }

  /** Bind the resources of both groups: with the streams, and with their scratch textures. */
  bindAll() {
    const {gpu, streams, structure, params} = this;
    const rest = new Map([
      [SHADING, gpu.bind(this.kinds, this.shadingResources)],
      [SEARCH, gpu.bind(structure.kinds, structure.resources)],
    ]);
    this.groups = new Map([SHADING, SEARCH].map(group => [group,
      [false, true].map(isScratch => [streams.bind(group, params, isScratch), rest.get(group)])]));
  }

  /** Shade pixels that wait for more room once they have it. */
  async resume() {
    const {gpu, streams, schedule, pixelCount} = this;
    if (!this.grow(pixelCount)) {
      throw new PageError("The paths behind glass of all pixels need too much memory.");
    }
    schedule.begin(streams);
    this.bindAll();
    const encoder = gpu.device.createCommandEncoder();
    const run = streams.begin(encoder, SEARCH);
    this.drawAll(run, SEARCH, true, [this.resuming]);
    run.end();
    this.waiting = (await schedule.read(encoder)).waiting;
  }

  note(kernel, rays) {
    this.passes.set(kernel, this.passes.get(kernel) + 1);
    this.last = {kernel, rays};
  }

  /** The light of all pixels, as `ImageRenderer.trace` returns it. */
  async finish() {
    const {gpu, streams, pixelCount: count, sample} = this;
    if (sample === 0) await this.checkBudgets();
    const vectors = PIXEL_TEXELS * count + streams.width; // the last row may be partly unused
    const records = this.scene.buffer("pixels and their rays", TEXEL_BYTES * vectors);
    const encoder = gpu.device.createCommandEncoder();
    streams.copyLight(encoder, records, TEXEL_BYTES * LIGHT * count);
    gpu.device.queue.submit([encoder.finish()]);
    this.sample = -1;
    const most = gpu.limits.maxComputeWorkgroupsPerDimension;
    return {count, records, dispatch: dispatchSize(count, GROUP_SIZE, most)};
  }

  async checkBudgets() {
    const state = await this.streams.read("state");
    for (let k = 3; k < state.length; k += 4) {
      checkEnded(this.structure, state[k]);
    }
  }
}
