// Chooses the next kernel on the device: counts rays by state, and gives the chosen kernel's draw
// one instance, all others none. The choices are those of raystream/machines/schedulers.py.

// Indirect arguments of a kernel's draws.
struct Arguments {
    corner_count: u32,
    instance_count: u32,
    first_corner: u32,
    first_instance: u32,
}

// A pass: its kernel, and the number of rays that waited for it.
struct Pass {
    kernel: u32,
    active_count: u32,
}

const NO_KERNEL: u32 = 0xffffffffu;

struct Schedule {
    arguments: array<Arguments, 8>,
    // Rays in each state.
    waiting: array<atomic<u32>, 16>,
    // The kernel that ran last.
    latest: u32,
    // Passes since the host read the record.
    pass_count: u32,
    // Rays that wait for any kernel.
    active_count: u32,
    // Rays that wait for more room.
    stuck_count: u32,
    passes: array<Pass>,
}

// The kernels, set-up first, shading last: the state of each, and whether it intersects.
struct Kernels {
    count: u32,
    tests: u32,
    states: array<vec4u, 2>,
}

@group(0) @binding(0) var states: texture_2d<u32>;
@group(0) @binding(1) var<storage, read_write> schedule: Schedule;
@group(0) @binding(2) var<uniform> kernels: Kernels;
// For each number of active rays, the fewest that must wait for an intersection.
@group(0) @binding(3) var<storage, read> least: array<u32>;

const THRESHOLD: u32 = 0u;
const NAIVE: u32 = 1u;
const MOST_WORK: u32 = 2u;
const DOUBLE: u32 = 3u;

// The state of rays that wait for more room; see states.wgsl.
const NO_ROOM: u32 = 8u;

override SCHEDULER: u32 = THRESHOLD;
// Whether shading spawns rays: then it is chosen like the kernels that do not intersect.
override SPAWNS: bool = false;
// Bit k: the host has encoded draws of kernel k. If another one is chosen, it waits.
override ENCODED: u32 = 0xffu;

var<workgroup> in_group: array<atomic<u32>, 16>;

@compute @workgroup_size(16, 16)
fn count_states(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    // Explicit, since not every driver clears it.
    if local < 16u {
        atomicStore(&in_group[local], 0u);
    }
    workgroupBarrier();
    if all(id.xy < textureDimensions(states)) {
        let state = textureLoad(states, id.xy, 0).x;
        if state != 0u {
            atomicAdd(&in_group[state & 15u], 1u);
        }
    }
    workgroupBarrier();
    if local < 16u {
        let count = atomicLoad(&in_group[local]);
        if count != 0u {
            atomicAdd(&schedule.waiting[local], count);
        }
    }
}

fn waiting_for(kernel: u32) -> u32 {
    return atomicLoad(&schedule.waiting[kernels.states[kernel / 4u][kernel % 4u]]);
}

fn is_test(kernel: u32) -> bool {
    return ((kernels.tests >> kernel) & 1u) != 0u;
}

// The kernel that shades.
fn shading() -> u32 {
    return kernels.count - 1u;
}

// The number of kernels that search: those before shading, which is one of them if it spawns rays.
fn searching_kernels() -> u32 {
    return kernels.count - select(1u, 0u, SPAWNS);
}

// The kernel with the most rays, the first one on ties: of all, or of those that search and do not
// intersect. NO_KERNEL if no ray waits.
fn fullest(is_of_others: bool) -> u32 {
    var best = NO_KERNEL;
    var most = 0u;
    for (var k = 0u; k < kernels.count; k++) {
        let is_left_out = is_of_others && (is_test(k) || k >= searching_kernels());
        if !is_left_out && waiting_for(k) > most {
            best = k;
            most = waiting_for(k);
        }
    }
    return best;
}

fn first_test() -> u32 {
    for (var k = 0u; k < shading(); k++) {
        if is_test(k) && waiting_for(k) != 0u {
            return k;
        }
    }
    return NO_KERNEL;
}

fn last_other() -> u32 {
    var last = NO_KERNEL;
    for (var k = 0u; k < searching_kernels(); k++) {
        if !is_test(k) && waiting_for(k) != 0u {
            last = k;
        }
    }
    return last;
}

fn or_shading(kernel: u32) -> u32 {
    return select(kernel, shading(), kernel == NO_KERNEL);
}

fn choose_naive() -> u32 {
    let test = first_test();
    return select(test, or_shading(last_other()), test == NO_KERNEL);
}

fn choose_by_threshold(active_count: u32) -> u32 {
    let test = first_test();
    let other = fullest(true);
    let searching = active_count - select(waiting_for(shading()), 0u, SPAWNS);
    if test != NO_KERNEL && (other == NO_KERNEL || waiting_for(test) >= least[searching]) {
        return test;
    }
    return or_shading(other);
}

fn choose_double() -> u32 {
    let best = fullest(false);
    let latest = schedule.latest;
    if latest == NO_KERNEL || waiting_for(best) > 2u * waiting_for(latest) {
        return best;
    }
    return latest;
}

fn choose(active_count: u32) -> u32 {
    switch SCHEDULER {
        case THRESHOLD: {
            return choose_by_threshold(active_count);
        }
        case NAIVE: {
            return choose_naive();
        }
        case DOUBLE: {
            return choose_double();
        }
        default: {
            return fullest(false);
        }
    }
}

@compute @workgroup_size(1)
fn decide() {
    var active_count = 0u;
    for (var k = 0u; k < kernels.count; k++) {
        active_count += waiting_for(k);
        schedule.arguments[k] = Arguments(3u, 0u, 0u, 0u);
    }
    schedule.active_count = active_count;
    schedule.stuck_count = atomicLoad(&schedule.waiting[NO_ROOM]);
    if active_count != 0u {
        let chosen = choose(active_count);
        if ((ENCODED >> chosen) & 1u) != 0u {
            schedule.arguments[chosen].instance_count = 1u;
            schedule.passes[schedule.pass_count] = Pass(chosen, waiting_for(chosen));
            schedule.pass_count += 1u;
            schedule.latest = chosen;
        }
    }
    for (var state = 0u; state < 16u; state++) {
        atomicStore(&schedule.waiting[state], 0u);
    }
}
