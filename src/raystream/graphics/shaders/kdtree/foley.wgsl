// Foley's layout (Foley 2005, Figure 5). As raystream/structures/kdtree/foley_layout.py.

// Three words each: position of the plane; the children below and above it, where bit 30 of the
// first is the low bit of the axis, and of the second the high one.
@group(1) @binding(0) var<storage, read> splits: array<u32>;
// Three words each: number of triangles, first block, the parent.
@group(1) @binding(2) var<storage, read> leaves: array<u32>;

// A node is a row of splits; or, with this bit, of leaves.
const LEAF_POINTER: u32 = 0x80000000u;
const AXIS_BIT: u32 = 30u;
const ROW_BITS: u32 = 0x3fffffffu;

fn is_leaf(node: u32) -> bool {
    return (node & LEAF_POINTER) != 0u;
}

fn split_of(node: u32) -> KdSplit {
    let below = splits[3u * node + 1u];
    let above = splits[3u * node + 2u];
    let axis = ((below >> AXIS_BIT) & 1u) | (((above >> AXIS_BIT) & 1u) << 1u);
    let pointer = LEAF_POINTER | ROW_BITS;
    return KdSplit(bitcast<f32>(splits[3u * node]), axis, below & pointer, above & pointer);
}

fn leaf_of(node: u32) -> KdLeaf {
    let row = 3u * (node & ROW_BITS);
    return KdLeaf(leaves[row + 1u], leaves[row]);
}
