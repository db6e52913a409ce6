// For traversals that keep nothing: memory for a stack is what they save (Foley 2005, section 3).

fn push(state: KdState, node: u32) -> u32 {
    return state.top;
}
