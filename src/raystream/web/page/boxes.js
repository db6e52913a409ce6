// Boxes of a structure's cells, nodes, leaves and sectors, from its shaders' arrays.

const LEAF_AXIS = 3; // of compact kd-trees
const LEAF_POINTER = 0x80000000, ROW_BITS = 0x3fffffff; // of Foley's layout
const WIDTH = 8, NODE = 64, LINKS = 48; // of a BVH
const SECTOR_ROWS = 4;

/**
 * A function of a visit (see walk.js) that returns {name, low, high}: what it is called, and its box in
 * world space. Null for a structure that has none.
 */
export function boxesOf(structure, {frame, bounds}) {
  const kind = KINDS[structure.about.shader];
  if (!kind) return null;
  const local = kind(structure.arrays(), new Uint32Array(structure.about.tree),
    bounds.map(corner => toLocal(corner, frame)), structure.about);
  return visit => {
    const {name, low, high} = local(visit);
    return {name, low: toWorld(low, frame), high: toWorld(high, frame)};
  };
}

const toLocal = (point, {center, scale}) => point.map((value, k) => (value - center[k]) * scale);
const toWorld = (point, {center, scale}) => [...point].map((value, k) => value / scale + center[k]);
const floatsOf = words => new Float32Array(words.buffer, words.byteOffset, words.length);
const wordsOf = array => new Uint32Array(array.buffer, array.byteOffset, array.length);

/** A cell of a lattice of counts cells. */
function cellOf(number, low, size, counts) {
  const at = [
    number % counts[0], Math.floor(number / counts[0]) % counts[1],
    Math.floor(number / (counts[0] * counts[1])),
  ];
  return {
    at, low: at.map((k, axis) => low[axis] + k * size[axis]),
    high: at.map((k, axis) => low[axis] + (k + 1) * size[axis]),
  };
}

function gridBoxes(arrays, tree) {
  const numbers = floatsOf(tree);
  const [low, size, counts] = [0, 8, 12].map(first => [...numbers.subarray(first, first + 3)]);
  const [children, lattices] = [arrays[3], wordsOf(arrays[4])];
  const coarse = number => cellOf(number, low, size, counts);
  const fine = number => {
    let row = lattices.length / 4 - 1;
    while (lattices[4 * row] > number) row--;
    const outer = coarse(children.indexOf(row));
    const inner = [...lattices.subarray(4 * row + 1, 4 * row + 4)];
    const step = inner.map((count, axis) => (outer.high[axis] - outer.low[axis]) / count);
    const cell = cellOf(number - lattices[4 * row], outer.low, step, inner);
    return {...cell, name: `cell (${cell.at}) of cell (${outer.at})`.replaceAll(",", ", ")};
  };
  return ({kind, number}) => {
    if (kind === "fine cell") return fine(number);
    const cell = coarse(number);
    return {...cell, name: `cell (${cell.at.join(", ")})`};
  };
}

/** Splits of a kd-tree: [node, axis, position, child below, child above]. */
function* kdSplits(words, isFoley) {
  const floats = floatsOf(words);
  for (let row = 0; isFoley && row < words.length / 3; row++) {
    const [below, above] = [words[3 * row + 1], words[3 * row + 2]];
    const axis = (below >>> 30 & 1) | (above >>> 30 & 1) << 1;
    const pointer = word => (word & (LEAF_POINTER | ROW_BITS)) >>> 0;
    yield [row, axis, floats[3 * row], pointer(below), pointer(above)];
  }
  for (let row = 0; !isFoley && row < words.length / 2; row++) {
    const [axis, child] = [words[2 * row + 1] & 3, words[2 * row + 1] >>> 2];
    if (axis !== LEAF_AXIS) yield [row, axis, floats[2 * row], child, child + 1];
  }
}

function kdBoxes(arrays, tree, _bounds, {instead}) {
  const isFoley = instead["kdtree/compact.wgsl"] === "kdtree/foley.wgsl";
  const numbers = floatsOf(tree);
  const corners = [0, 4].map(first => [...numbers.subarray(first, first + 3)]);
  const parents = new Map();
  for (const [node, axis, position, below, above] of kdSplits(wordsOf(arrays[0]), isFoley)) {
    parents.set(below, {node, axis, position, isBelow: true});
    parents.set(above, {node, axis, position, isBelow: false});
  }
  return ({kind, number}) => {
    const [low, high] = corners.map(corner => [...corner]);
    const cut = [[], []];
    for (let at = parents.get(number); at; at = parents.get(at.node)) {
      // Upwards: the first plane of each side counts.
      const side = Number(at.isBelow);
      if (!cut[side][at.axis]) [low, high][side][at.axis] = at.position;
      cut[side][at.axis] = true;
    }
    const isLeaf = kind === "leaf" || (isFoley && number >= LEAF_POINTER);
    const shown = isFoley ? number & ROW_BITS : number;
    return {name: `${isLeaf ? "leaf" : "split"} ${shown}`, low, high};
  };
}

function bvhBoxes([nodes], _tree, bounds) {
  const [planes, links] = [floatsOf(nodes), new Int32Array(nodes.buffer, nodes.byteOffset, nodes.length)];
  const slots = new Map(); // of links, in their parents
  for (let node = 0; node < nodes.length / NODE; node++) {
    for (let lane = 0; lane < WIDTH; lane++) {
      const link = links[NODE * node + LINKS + lane];
      // A leaf's link has its first block above the number of blocks.
      if (link) slots.set(link < 0 ? ~(~link >> 3) : link, NODE * node + lane);
    }
  }
  return ({kind, number}) => {
    const name = `${kind} ${number}`;
    const slot = slots.get(kind === "leaf" ? ~number : number);
    if (slot === undefined) return {name, low: bounds[0], high: bounds[1]};
    const corner = first => [0, 1, 2].map(axis => planes[slot + first + 16 * axis]);
    return {name, low: corner(0), high: corner(8)};
  };
}

function graphBoxes([rows], tree) {
  const numbers = floatsOf(tree);
  const planes = floatsOf(rows);
  const clip = (value, axis) => Math.min(Math.max(value, numbers[axis]), numbers[4 + axis]);
  return ({number}) => ({
    name: `sector ${number / SECTOR_ROWS}`,
    low: [0, 1, 2].map(axis => clip(planes[4 * number + axis], axis)),
    high: [0, 1, 2].map(axis => clip(planes[4 * number + 4 + axis], axis)),
  });
}

const KINDS = {
  "grid.wgsl": gridBoxes, "kdtree.wgsl": kdBoxes, "bvh.wgsl": bvhBoxes, "graph.wgsl": graphBoxes,
};
