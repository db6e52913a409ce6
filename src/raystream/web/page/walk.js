// What a ray's search visits in a structure, as the shaders do it.

import {cached} from "./device.js";
import {CUT_SHORT, checkEnded, dispatch, localRays, paramsOf} from "./queries.js";
import {length} from "./vector.js";

const LAYOUT = ["uniform", "gather", "scatter", "scatter"];
const WORDS = 5; // of a Visit
const MOST_VISITS = 1 << 10;

/** The kinds of visits, in the order of visit_kinds.wgsl. */
const KINDS = ["cell", "fine cell", "split", "up", "restart", "leaf", "node", "sector", "end"];

/**
 * What the search for a ray's nearest hit visits: {visits, count}, the first visits and the number of
 * all. Each is {kind, number, tests, primId, distance}: the triangles tested there, and the nearest hit after
 * that and its distance, -1 and Infinity if there is none.
 */
export async function recordWalk(queries, ray) {
  const {gpu, scene, structure, pipelines} = queries;
  const {packed, lengths} = localRays(scene.frame, ray);
  const pipeline = await cached(pipelines, "walk", () => gpu.pipeline({
    source: structure.source(scene.shaders, ["page/walk.wgsl"],
      {instead: {"visits.wgsl": "page/record_visits.wgsl"}}),
    entry: "walk", layouts: [LAYOUT, structure.kinds], constants: structure.about.constants,
  }));
  const run = {
    pipeline, layout: LAYOUT, groups: [1],
    contents: [
      ["params", paramsOf(scene, structure.about, {rayCount: 1, rowSize: 1}), GPUBufferUsage.UNIFORM],
      ["rays", packed], ["visits", 4 * WORDS * MOST_VISITS], ["ending", 8],
    ],
  };
  const [total, code, words] = await dispatch(gpu, structure, run, async (...buffers) => {
    const ending = new Uint32Array(await gpu.read(buffers[3], 8));
    return [...ending, await gpu.read(buffers[2], 4 * WORDS * Math.min(ending[0], MOST_VISITS))];
  });
  checkEnded(structure, code && code < CUT_SHORT);
  // From local distances to those of world space.
  const factor = length(ray.slice(3)) / lengths[0];
  return {visits: visitsOf(words, factor), count: total - 1};
}

/** Records hold what was before each visit: that after it is in the next one. */
function visitsOf(words, factor) {
  const [bits, floats] = [new Int32Array(words), new Float32Array(words)];
  const visits = [];
  for (let at = 0; at + WORDS < bits.length; at += WORDS) {
    const after = at + WORDS;
    const primId = bits[after + 3];
    visits.push({
      kind: KINDS[bits[at]], number: bits[at + 1] >>> 0, tests: bits[after + 2] - bits[at + 2], primId,
      distance: primId < 0 ? Infinity : floats[after + 4] * factor,
    });
  }
  return visits;
}
