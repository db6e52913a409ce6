// Queries of single rays or batches on the GPU: as raystream/graphics/dispatches.py.

import {bvhArrays} from "./geometry.js";
import {cached, dispatchSize} from "./device.js";
import {PageError} from "./pack.js";
import {gatherArrays, inTextures, shaderSource} from "./shaders.js";

const GROUP_SIZE = 64;
const LAYOUT = ["uniform", "gather", "gather", "scatter", "scatter", "scatter"];
const OTHERS = LAYOUT.length - 1; // buffers besides the structure's
const KIND = {firstHit: 0, countHits: 2, multiHit: 3};
const ENDLESS = 0xffffffff;
export const CUT_SHORT = 0xfffffffe;
const FAR = 3.4028234663852886e38;

/** The counts of a ray, in the order of tally.wgsl. */
export const COUNTED = [
  "steps", "leaves", "tests", "restarts", "backtracks", "backtrack_steps", "shadings", "link_nodes",
];

/** The uniform Params of a structure's shaders. */
export function paramsOf(scene, structure, {rayCount, rowSize, capacity = 0}) {
  const words = new Uint32Array(8 + Math.ceil(structure.tree.length / 4) * 4);
  new Float32Array(words.buffer)[0] = scene.frame.max_coordinate;
  words.set([0, rayCount, rowSize, structure.budget, capacity], 1);
  words.set(structure.tree, 8);
  return words;
}

/** A structure on the GPU. */
export class StructureOnGpu {
  constructor(gpu, {manifest, arrays}, corners, name) {
    this.name = name;
    this.about = manifest.structures[name];
    const own = this.about.arrays.map(key => arrays[key]);
    /** Arrays on the host; those of a BVH are made again for each call. */
    this.arrays = () => (this.about.how === "bvh" ? bvhArrays(...own, corners) : own);
    const made = this.arrays();
    // Shaders may have few buffers, beside as many textures.
    this.isInTextures = made.length + OTHERS > gpu.limits.maxStorageBuffersPerShaderStage;
    if (this.isInTextures) {
      const declared = gatherArrays(this.plainSource(manifest.shaders, []), 1);
      const byName = Object.fromEntries(declared.map(one => [one.name, made[one.binding]]));
      const {kinds, resources} = gpu.textures(declared, byName);
      [this.kinds, this.resources] = [kinds, resources];
    } else {
      this.kinds = made.map(() => "gather");
      this.resources = made.map((array, k) => gpu.shared("buffer", array,
        () => gpu.buffer(`${name}, array ${k}`, array)));
    }
  }

  plainSource(files, names, options = {}) {
    const {shader, sizes, instead} = this.about;
    return shaderSource(files, [...names, shader],
      {...options, sizes, instead: {...instead, ...options.instead}});
  }

  /** The source of a machine's files and the structure's, which reads its arrays where they are. */
  source(files, names, options = {}) {
    const source = this.plainSource(files, names, options);
    return this.isInTextures ? inTextures(source, options.treeGroup ?? 1) : source;
  }
}

/** Check that all searches in a structure ended. */
export function checkEnded({name}, haveEnded) {
  if (!haveEnded) throw new PageError(`Searches in ${name} did not end on this GPU.`);
}

/**
 * Run a pipeline once on a structure and buffers, whose arguments are `contents`; returns what
 * `read` does of them. They are destroyed then.
 */
export async function dispatch(gpu, structure, {pipeline, layout, contents, groups}, read) {
  const buffers = [];
  try {
    for (const one of contents) buffers.push(gpu.buffer(...one));
    const encoder = gpu.device.createCommandEncoder();
    const pass = encoder.beginComputePass();
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, gpu.bind(layout, buffers));
    pass.setBindGroup(1, gpu.bind(structure.kinds, structure.resources));
    pass.dispatchWorkgroups(...groups);
    pass.end();
    gpu.device.queue.submit([encoder.finish()]);
    return await read(...buffers);
  } finally {
    buffers.forEach(buffer => buffer.destroy());
  }
}

export class Queries {
  constructor(gpu, scene, structure) {
    this.gpu = gpu;
    this.scene = scene;
    this.structure = structure;
    this.pipelines = new Map();
  }

  pipeline(kind, counts) {
    const {structure} = this;
    return cached(this.pipelines, `${kind} ${counts}`, () => this.gpu.pipeline({
      source: structure.source(this.scene.shaders, ["compute.wgsl"]),
      entry: "trace", layouts: [LAYOUT, structure.kinds],
      constants: {...structure.about.constants, QUERY: KIND[kind], COUNTS: Number(counts)},
    }));
  }

  /** The nearest hit of each ray: {t, u, v, primId}; t is Infinity and primId -1 for a miss. */
  async firstHit(rays) {
    const count = rays.length / 6;
    const {rows} = await this.run("firstHit", rays, new Uint32Array(2), count, 1);
    return hitsOf(rows, count);
  }

  /** All hits of a ray, nearest first. */
  async allHits(ray) {
    const {endings} = await this.run("countHits", ray, new Uint32Array(2), 0, 0xfffffffc);
    const count = endings[0] - 1;
    if (!count) return hitsOf(new Float32Array(0), 0);
    const {rows} = await this.run("multiHit", ray, Uint32Array.of(0, count), count, count);
    return hitsOf(rows, count);
  }

  /** Counts of each ray's search for its nearest hit: rows of COUNTED. */
  async counts(rays) {
    const {tallies} = await this.run("firstHit", rays, new Uint32Array(2), rays.length / 6, 1, true);
    return tallies;
  }

  /** Trace rays: origin and direction in world space, six numbers each. */
  async run(kind, rays, wanted, rowCount, capacity, counts = false) {
    const {gpu, scene, structure} = this;
    const count = rays.length / 6;
    const {columns, rows, rowSize} = dispatchSize(count, GROUP_SIZE);
    const {packed, lengths} = localRays(scene.frame, rays);
    const params = paramsOf(scene, structure.about, {rayCount: count, rowSize, capacity});
    const contents = [
      ["params", params, GPUBufferUsage.UNIFORM], ["rays", packed], ["wanted", wanted],
      ["rows", 16 * rowCount], ["endings", 4 * count],
      ["tallies", counts ? 4 * COUNTED.length * count : 0],
    ];
    const pipeline = await this.pipeline(kind, counts);
    const run = {pipeline, layout: LAYOUT, contents, groups: [columns, rows]};
    const answers = await dispatch(gpu, structure, run, async (...buffers) => ({
      endings: new Uint32Array(await gpu.read(buffers[4], 4 * count)),
      rows: new Float32Array(rowCount ? await gpu.read(buffers[3], 16 * rowCount) : 0),
      tallies: counts
        ? new Uint32Array(await gpu.read(buffers[5], 4 * COUNTED.length * count)) : null,
    }));
    checkEnded(structure, answers.endings.every(
      code => code && code !== ENDLESS && code !== CUT_SHORT));
    for (let row = 0; row < rowCount; row++) {
      answers.rows[4 * row] /= lengths[rowCount === count ? row : 0];
    }
    return answers;
  }
}

/** Rays in the local frame, the largest component of the direction in [1, 2). */
export function localRays({center, scale}, rays) {
  const count = rays.length / 6;
  const packed = new Float32Array(8 * count);
  const lengths = new Float64Array(count); // local units of t per world unit
  for (let i = 0; i < count; i++) {
    const largest = Math.max(...[3, 4, 5].map(k => Math.abs(rays[6 * i + k])));
    const power = 2 ** -Math.floor(Math.log2(largest));
    for (let axis = 0; axis < 3; axis++) {
      packed[8 * i + axis] = (rays[6 * i + axis] - center[axis]) * scale;
      packed[8 * i + 4 + axis] = rays[6 * i + 3 + axis] * power;
    }
    packed[8 * i + 7] = FAR;
    lengths[i] = scale / power;
  }
  return {packed, lengths};
}

function hitsOf(rows, count) {
  const bits = new Int32Array(rows.buffer);
  const column = k => Array.from({length: count}, (_, i) => rows[4 * i + k]);
  const primId = Array.from({length: count}, (_, i) => bits[4 * i + 3]);
  const t = column(0).map((value, i) => (primId[i] < 0 ? Infinity : value));
  return {t, u: column(1), v: column(2), primId};
}
