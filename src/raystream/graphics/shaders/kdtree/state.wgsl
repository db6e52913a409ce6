// The traversal state of a ray in a kd-tree. As raystream/structures/kdtree/state.py.

struct KdState {
    // A node; see the layout.
    node: u32,
    // The part of the ray in the node: t_in <= t < t_out.
    t_in: f32,
    t_out: f32,
    // End of the search: just after the last t of the interval.
    t_end: f32,
    // Nodes on the stack.
    top: u32,
    // The search continues above the node: backtrack() is next.
    is_backtracking: bool,
}

// A node with a plane, and its children.
struct KdSplit {
    position: f32,
    axis: u32,
    below: u32,
    above: u32,
}

// The triangles of a leaf: their first block, and their number.
struct KdLeaf {
    block: u32,
    triangle_count: u32,
}
