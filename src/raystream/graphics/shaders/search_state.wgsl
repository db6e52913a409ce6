// The state of a search: hits so far, and when it is over. As raystream/kernels/search.py.

const FIRST_HIT: u32 = 0u;
const ANY_HIT: u32 = 1u;
const COUNT_HITS: u32 = 2u;
const MULTI_HIT: u32 = 3u;

// Constants of the pipeline: one of these, and whether a ray through an edge crosses once.
override QUERY: u32 = 0u;
override SURFACES: bool = false;

const MISS: i32 = -1;

struct SearchState {
    // Hits beyond are ignored.
    t_far: f32,
    // Hits so far; for MULTI_HIT, those that are kept.
    count: u32,
    // Most hits wanted; rows from `first` on are this ray's.
    capacity: u32,
    first: u32,
    // The nearest hit, for FIRST_HIT.
    t: f32,
    u: f32,
    v: f32,
    prim_id: i32,
    // Steps and tests left before the search counts as endless.
    budget: u32,
}

struct Row {
    t: f32,
    u: f32,
    v: f32,
    prim_id: i32,
}

var<private> found: SearchState;

fn begin_search_state(t_max: f32, first: u32, capacity: u32) {
    found = SearchState(t_max, 0u, capacity, first, FAR, 0.0, 0.0, MISS, params.budget);
}

// Whether no hit can change the result any more.
fn is_full() -> bool {
    return (QUERY == ANY_HIT || QUERY == COUNT_HITS) && found.count >= found.capacity;
}

// Whether no hit at t or beyond can change the result; ties at t_far can.
fn is_over(t: f32) -> bool {
    return found.t_far < t || is_full();
}

// Spend budget for a step or a test. False if none is left: then the search must end, which becomes
// an error on the host.
fn spend_budget() -> bool {
    if found.budget == 0u {
        return false;
    }
    found.budget -= 1u;
    return true;
}

fn is_before(t: f32, prim_id: i32, other_t: f32, other_prim_id: i32) -> bool {
    return t < other_t || (t == other_t && prim_id < other_prim_id);
}

//! include "offer.wgsl"

// Keep or count a hit.
fn take(hit: Hit, prim_id: i32) {
    if QUERY == FIRST_HIT {
        if is_before(hit.t, prim_id, found.t, found.prim_id) || found.prim_id == MISS {
            found.t = hit.t;
            found.u = hit.u;
            found.v = hit.v;
            found.prim_id = prim_id;
            found.t_far = hit.t;
        }
    } else if QUERY == MULTI_HIT {
        keep(Row(hit.t, hit.u, hit.v, prim_id));
    } else {
        found.count += 1u;
    }
}
