// Whether loops still run to their end.
//
// Mesa's software driver limits all loops of an invocation, and of those in its group, to 65,535
// iterations altogether. After that each loop silently ends after one iteration, with wrong
// results. One of these two iterations would then be missing.
//
// Source: LP_MAX_TGSI_LOOP_ITERATIONS in Mesa's gallivm.

fn loops_run() -> bool {
    var rounds = 0u;
    while rounds < 2u + params.zero {
        rounds += 1u;
    }
    return rounds == 2u;
}
