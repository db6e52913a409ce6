// Whether loops still run to their ends.
//
// Mesa's software driver lets all loops of an invocation, and of those that run beside it, run
// 65,535 rounds altogether. After that, each loop runs one round and is left, as if nothing was:
// results are wrong then. Of these two rounds one would be missing.
//
// Source: LP_MAX_TGSI_LOOP_ITERATIONS in Mesa's gallivm.

fn loops_run() -> bool {
    var rounds = 0u;
    while rounds < 2u + params.zero {
        rounds += 1u;
    }
    return rounds == 2u;
}
