// Short stack: after a leaf, pop the last nodes; if they were dropped, restart at the lowest node
// that holds the rest of the ray. As raystream/structures/kdtree/traversals/short_stack.py.
//
// Horn and others, "Interactive k-D Tree GPU Raytracing", Interactive 3D Graphics 2007.

const PLACES: u32 = 4u;
const COUNT_SHIFT: u32 = 8u;

struct KdEntry {
    node: u32,
    t_out: f32,
}

var<private> ring: array<KdEntry, PLACES>;

// The node of restarts.
var<private> lowest: u32;

// Returns the next place in the ring, and the number of nodes kept.
fn push(state: KdState, node: u32) -> u32 {
    if state.t_out == state.t_end {
        lowest = state.node;
    }
    let place = state.top % PLACES;
    ring[place] = KdEntry(node, state.t_out);
    let count = min((state.top >> COUNT_SHIFT) + 1u, PLACES);
    return ((place + 1u) % PLACES) | (count << COUNT_SHIFT);
}

fn has_forgotten(state: KdState) -> bool {
    return (state.top >> COUNT_SHIFT) == 0u;
}

fn continue_search(state: KdState) -> KdState {
    if has_forgotten(state) {
        return KdState(lowest, state.t_out, state.t_end, state.t_end, 0u, false);
    }
    let place = (state.top + PLACES - 1u) % PLACES;
    let entry = ring[place];
    let count = (state.top >> COUNT_SHIFT) - 1u;
    let top = place | (count << COUNT_SHIFT);
    return KdState(entry.node, state.t_out, entry.t_out, state.t_end, top, false);
}

fn continue_counted(line: PlaneRay, state: KdState) -> KdState {
    if has_forgotten(state) {
        visited(RESTART, lowest);
        tally.restarts += 1u;
    }
    return continue_search(state);
}
