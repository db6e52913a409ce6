// Counters of rays. Without counters, no_counters.wgsl replaces this file.

@group(2) @binding(1) var<storage, read_write> tallies: array<Tally>;
// Runs of each kernel on each ray: eight words per ray.
@group(2) @binding(2) var<storage, read_write> runs: array<u32>;

// A kernel with too many streams for the adapter's render targets is drawn more than once; one of
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
