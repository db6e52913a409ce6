// The kd-backtrack traversal: after a leaf, climb to the node that holds the rest of the ray (Foley
// 2005, Figure 4).

//! include "kdtree/no_stack.wgsl"
//! include "kdtree/compact_parents.wgsl"

// Foley's ExtendedSplit: corners of a split's box, FAR at the border of the scene, where no plane
// ends the search; and a link, see the layout.
struct KdExtended {
    low: vec3f,
    high: vec3f,
    link: u32,
}

fn extended_of(row: u32) -> KdExtended {
    let first = extended[2u * row];
    let second = extended[2u * row + 1u];
    let low = bitcast<vec3f>(first.xyz);
    let high = bitcast<vec3f>(vec3u(first.w, second.xy));
    return KdExtended(low, high, second.z);
}

fn continue_search(state: KdState) -> KdState {
    return KdState(state.node, state.t_out, state.t_end, state.t_end, 0u, true);
}

// Climb to the parent of a node; stop there if it holds t_in (Foley's Up). Ancestors hold all that
// was searched, so only the exit distance is tested: that of the first plane the ray moves towards.
// The root has no such plane.
fn backtrack(line: PlaneRay, state: KdState) -> KdState {
    let row = parent_row(state.node);
    let parent = extended_of(row);
    let ends = select(parent.low, parent.high, line.inv > vec3f(0.0));
    let t = distances_to(line, ends, FAR);
    let t_out = min(min(t.x, t.y), t.z);
    let is_backtracking = !(state.t_in < t_out);
    let node = node_of_row(row, parent.link);
    return KdState(node, state.t_in, min(t_out, state.t_end), state.t_end, 0u, is_backtracking);
}

fn continue_counted(line: PlaneRay, state: KdState) -> KdState {
    tally.backtracks += 1u;
    var next = continue_search(state);
    while next.is_backtracking && spend_budget() {
        visited(UP, next.node);
        next = backtrack(line, next);
        tally.backtrack_steps += 1u;
    }
    return next;
}
