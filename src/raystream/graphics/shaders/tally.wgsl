// What a ray meets, in the order of raystream/kernels/tally.py.

struct Tally {
    steps: u32,
    leaves: u32,
    tests: u32,
    restarts: u32,
    backtracks: u32,
    backtrack_steps: u32,
    shadings: u32,
    link_nodes: u32,
}

var<private> tally: Tally;
