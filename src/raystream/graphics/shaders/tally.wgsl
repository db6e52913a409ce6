// Counters of a ray, in the order of raystream/kernels/tally.py.

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

// Count shaded hits, unless hits are only counted.
fn note_shadings() {
    if QUERY == FIRST_HIT {
        tally.shadings = u32(found.prim_id != MISS);
    } else if QUERY != COUNT_HITS {
        tally.shadings = found.count;
    }
}
