// What a ray has found, and what it still wants. As raystream/kernels/hits.py.

const FIRST_HIT: u32 = 0u;
const ANY_HIT: u32 = 1u;
const COUNT_HITS: u32 = 2u;
const MULTI_HIT: u32 = 3u;

// Of the pipeline: one of these, and what a ray through an edge meets.
override QUERY: u32 = 0u;
override SURFACES: bool = false;

const MISS: i32 = -1;

struct SearchState {
    // Hits beyond are not wanted.
    t_far: f32,
    // Hits so far; of MULTI_HIT those that are kept.
    count: u32,
    // How many are wanted: rows from `first` on are this ray's.
    capacity: u32,
    first: u32,
    // The nearest one, of FIRST_HIT.
    t: f32,
    u: f32,
    v: f32,
    prim_id: i32,
    // Steps and tests that are left before a search counts as endless.
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

// Whether the search has all that it wants, wherever it is.
fn is_enough() -> bool {
    return (QUERY == ANY_HIT || QUERY == COUNT_HITS) && found.count >= found.capacity;
}

// Whether nothing at t or after it is wanted; ties at t_far are.
fn is_past(t: f32) -> bool {
    return found.t_far < t || is_enough();
}

// Pay for a step or a test. False if the budget is spent: then the search must end, and whoever
// asked is told.
fn spend() -> bool {
    if found.budget == 0u {
        return false;
    }
    found.budget -= 1u;
    return true;
}

fn is_before(t: f32, prim_id: i32, other_t: f32, other_prim_id: i32) -> bool {
    return t < other_t || (t == other_t && prim_id < other_prim_id);
}

// Offer a hit: with t <= t_far, and once for each triangle.
fn offer(hit: Hit, prim_id: i32) {
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
