// Adding up what rays meet. Where nobody counts, no_counters.wgsl takes this file's place.

@group(2) @binding(1) var<storage, read_write> tallies: array<Tally>;
// How often each kernel ran on each ray: eight words of each.
@group(2) @binding(2) var<storage, read_write> runs: array<u32>;

// A kernel whose streams are too many for the adapter's targets is drawn more than once; one of
// the draws counts.
override COUNTS: bool = true;

fn add_tallies(ray: u32) {
    if !COUNTS {
        return;
    }
    tallies[ray].steps += tally.steps;
    tallies[ray].leaves += tally.leaves;
    tallies[ray].tests += tally.tests;
    tallies[ray].restarts += tally.restarts;
    tallies[ray].backtracks += tally.backtracks;
    tallies[ray].backtrack_steps += tally.backtrack_steps;
    tallies[ray].shadings += tally.shadings;
    tallies[ray].link_nodes += tally.link_nodes;
}

fn add_runs(ray: u32, kernel: u32, count: u32) {
    if COUNTS {
        runs[8u * ray + kernel] += count;
    }
}
