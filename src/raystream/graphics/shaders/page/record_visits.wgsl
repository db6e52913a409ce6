// Records what a search visits, with its counts and its nearest hit before.

//! include "visit_kinds.wgsl"

struct Visit {
    kind: u32,
    number: u32,
    tests: u32,
    prim_id: i32,
    t: f32,
}

@group(0) @binding(2) var<storage, read_write> visits: array<Visit>;

// Visits so far, those beyond the room, too.
var<private> visit_count: u32;

fn visited(kind: u32, number: u32) {
    if visit_count < arrayLength(&visits) {
        visits[visit_count] = Visit(kind, number, tally.tests, found.prim_id, found.t);
    }
    visit_count += 1u;
}
