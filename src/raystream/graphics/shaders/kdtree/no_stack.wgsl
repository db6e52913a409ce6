// For traversals that keep nothing: memory for a stack is what they save (Foley 2005, section 3).

fn push(top: u32, node: u32, t_out: f32) -> u32 {
    return top;
}
