// How the search of a ray ended. As raystream/graphics/endings.py; 0 is that of one which did not
// run.

// It took more steps and tests than any search can.
const ENDLESS: u32 = 0xffffffffu;

// Its loops were left too early.
const CUT_SHORT: u32 = 0xfffffffeu;

//! include "loop_limit.wgsl"

// One of these, or one more than the hits found.
fn termination_code() -> u32 {
    if !loops_run() {
        return CUT_SHORT;
    }
    return select(found.count + 1u, ENDLESS, found.budget == 0u);
}
