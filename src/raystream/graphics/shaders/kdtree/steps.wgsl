// The steps that Foley's traversals share. As raystream/structures/kdtree/traversal.py, where it is
// said why no ray loops. A traversal has push(), continue_search() and continue_counted().
//
// Foley and Sugerman, "KD-Tree Acceleration Structures for a GPU Raytracer", Graphics Hardware
// 2005, Figures 2 to 4, and section 3.3.

// Start at the root (Foley's Initialize).
fn initialize(ray: Ray) -> KdState {
    let part = searched_part(ray, params.tree.low, params.tree.high);
    return KdState(params.tree.root, part.t_in, part.t_out, part.t_out, 0u, false);
}

// Whether the ray enters the tree.
fn is_active(state: KdState) -> bool {
    return params.tree.node_count != 0u && state.t_in < state.t_end;
}

fn is_at_leaf(state: KdState) -> bool {
    return is_leaf(state.node);
}

// Descend from a split to the child that holds t_in (Foley's Down).
fn descend(line: PlaneRay, state: KdState) -> KdState {
    let split = split_of(state.node);
    let t = distance_to(line, split.axis, split.position);
    let is_upward = line.inv[split.axis] > 0.0;
    let first = select(split.above, split.below, is_upward);
    let second = select(split.below, split.above, is_upward);
    var next = state;
    next.node = select(first, second, t <= state.t_in);
    if t > state.t_in && t < state.t_out {
        next.top = push(state, second);
        next.t_out = t;
    }
    return next;
}

// Find the triangles of the leaf that the search is at (Foley's Leaf).
fn leaf(state: KdState) -> KdLeaf {
    return leaf_of(state.node);
}
