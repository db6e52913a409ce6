// Stack: after a leaf, pop what descend() pushed: a node and the end of its interval for each split
// on a path. STACK_SIZE is declared by the source.

struct KdEntry {
    node: u32,
    t_out: f32,
}

var<private> stack: array<KdEntry, STACK_SIZE>;

// Returns the new number of nodes on the stack.
fn push(state: KdState, node: u32) -> u32 {
    stack[state.top] = KdEntry(node, state.t_out);
    return state.top + 1u;
}

// The child on top begins where the leaf ends: only such children were pushed.
fn continue_search(state: KdState) -> KdState {
    let top = state.top - 1u;
    let entry = stack[top];
    return KdState(entry.node, state.t_out, entry.t_out, state.t_end, top, false);
}

fn continue_counted(line: PlaneRay, state: KdState) -> KdState {
    return continue_search(state);
}
