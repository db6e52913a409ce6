// Makes the arrays of shaders that an exported page leaves out; see raystream/web/geometry.py.

const WIDTH = 8, NODE = 64, BLOCK = 40, SLOTS = 4;

/** The corners of all triangles, nine numbers each. */
export function cornersOf(vertices, faces) {
  const corners = new Float32Array(3 * faces.length);
  faces.forEach((vertex, k) => {
    for (let axis = 0; axis < 3; axis++) corners[3 * k + axis] = vertices[3 * vertex + axis];
  });
  return corners;
}

/** Nodes and leaf blocks of a BVH: the bits that raystream built. */
export function bvhArrays(links, primIds, corners) {
  const blocks = blocksOf(primIds, corners);
  const nodes = new Float32Array(links.length / WIDTH * NODE);
  const bits = new Int32Array(nodes.buffer);
  const boxes = new Float32Array(links.length / WIDTH * 6); // of nodes: low, then high
  for (let node = links.length / WIDTH - 1; node >= 0; node--) {
    const own = emptyBox();
    for (let k = 0; k < WIDTH; k++) {
      const link = links[WIDTH * node + k];
      const box = emptyBox();
      if (link > 0) grow(box, boxes.subarray(6 * link, 6 * link + 6));
      else if (link < 0) growByLeaf(box, ~link >> 3, (~link & 7) + 1, primIds, corners);
      for (let axis = 0; axis < 3; axis++) {
        nodes[NODE * node + 16 * axis + k] = box[axis];
        nodes[NODE * node + 16 * axis + 8 + k] = box[3 + axis];
      }
      bits[NODE * node + 48 + k] = link;
      grow(own, box);
    }
    boxes.set(own, 6 * node);
  }
  return [new Uint32Array(nodes.buffer), new Uint32Array(blocks.buffer)];
}

function blocksOf(primIds, corners) {
  const count = primIds.length / SLOTS;
  const blocks = new Float32Array(count * BLOCK);
  const bits = new Int32Array(blocks.buffer);
  for (let block = 0; block < count; block++) {
    for (let slot = 0; slot < SLOTS; slot++) {
      const prim = primIds[SLOTS * block + slot];
      for (let k = 0; prim >= 0 && k < 9; k++) {
        blocks[BLOCK * block + SLOTS * k + slot] = corners[9 * prim + k];
      }
      bits[BLOCK * block + 36 + slot] = prim;
    }
  }
  return blocks;
}

const emptyBox = () => Float32Array.of(Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity);

function grow(box, other) {
  for (let axis = 0; axis < 3; axis++) {
    box[axis] = Math.min(box[axis], other[axis]);
    box[3 + axis] = Math.max(box[3 + axis], other[3 + axis]);
  }
}

function growByLeaf(box, first, count, primIds, corners) {
  for (const prim of primIds.subarray(SLOTS * first, SLOTS * (first + count))) {
    for (let k = 0; prim >= 0 && k < 9; k++) {
      const value = corners[9 * prim + k];
      box[k % 3] = Math.min(box[k % 3], value);
      box[3 + k % 3] = Math.max(box[3 + k % 3], value);
    }
  }
}
