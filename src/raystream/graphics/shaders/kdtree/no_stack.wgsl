// For stackless traversals (Foley 2005, section 3).

fn push(state: KdState, node: u32) -> u32 {
    return state.top;
}
