// Nodes of 8 bytes; children lie side by side. As raystream/structures/kdtree/layout.py and
// nodes.py.

// A split: position of its plane; index of the child below, and axis. A leaf: its first block;
// number of triangles, and LEAF_AXIS.
@group(1) @binding(0) var<storage, read> nodes: array<vec2u>;

const LEAF_AXIS: u32 = 3u;

fn is_leaf(node: u32) -> bool {
    return (nodes[node].y & 3u) == LEAF_AXIS;
}

fn split_of(node: u32) -> KdSplit {
    let words = nodes[node];
    let below = words.y >> 2u;
    return KdSplit(bitcast<f32>(words.x), words.y & 3u, below, below + 1u);
}

fn leaf_of(node: u32) -> KdLeaf {
    let words = nodes[node];
    return KdLeaf(words.x, words.y >> 2u);
}
