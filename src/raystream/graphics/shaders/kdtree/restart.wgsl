// Going on after a leaf from the root again: kd-restart (Foley 2005, Figure 3).

//! include "kdtree/no_stack.wgsl"

fn leave(state: KdState) -> KdState {
    return KdState(params.tree.root, state.t_out, state.t_end, state.t_end, 0u, false);
}

// No ray climbs.
fn up(line: PlaneRay, state: KdState) -> KdState {
    return state;
}

fn go_on(line: PlaneRay, state: KdState) -> KdState {
    tally.restarts += 1u;
    return leave(state);
}
