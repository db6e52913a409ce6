// Termination codes, as raystream/graphics/termination.py; 0 is that of a ray which was not traced.

// The budget is spent.
const ENDLESS: u32 = 0xffffffffu;

// A driver ended loops early.
const CUT_SHORT: u32 = 0xfffffffeu;

//! include "loop_limit.wgsl"

// One of these codes, or one more than the number of hits.
fn termination_code() -> u32 {
    if !loops_run() {
        return CUT_SHORT;
    }
    return select(found.count + 1u, ENDLESS, found.budget == 0u);
}
