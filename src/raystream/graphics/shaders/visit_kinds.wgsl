// The kinds of what a search visits, each with a number of its own.

// A cell of a grid, and one of its second level.
const CELL: u32 = 0u;
const FINE_CELL: u32 = 1u;
// A split of a kd-tree that is descended, and a node that is left for its parent.
const SPLIT: u32 = 2u;
const UP: u32 = 3u;
// The node of a restart.
const RESTART: u32 = 4u;
// A leaf of a kd-tree, which is a node; of a BVH, its first block.
const LEAF: u32 = 5u;
// A node of a BVH.
const BOXES: u32 = 6u;
// The row of a sector.
const SECTOR: u32 = 7u;
// The end of the search.
const END: u32 = 8u;
