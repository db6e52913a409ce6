// The kd-restart traversal: after a leaf, restart at the root (Foley 2005, Figure 3).

//! include "kdtree/no_stack.wgsl"

fn continue_search(state: KdState) -> KdState {
    return KdState(params.tree.root, state.t_out, state.t_end, state.t_end, 0u, false);
}

// Never called: kd-restart has no such step.
fn backtrack(line: PlaneRay, state: KdState) -> KdState {
    return state;
}

fn continue_counted(line: PlaneRay, state: KdState) -> KdState {
    visited(RESTART, params.tree.root);
    tally.restarts += 1u;
    return continue_search(state);
}
