// Brute force: all triangles in order (Foley 2005, section 4).

// The prim_ids of triangles that can be hit.
@group(1) @binding(0) var<storage, read> prim_ids: array<u32>;
// Vertices of all triangles: nine numbers each.
@group(1) @binding(1) var<storage, read> corners: array<f32>;

//! include "vertices.wgsl"
//! include "brute_rows.wgsl"

// Test the triangle in a row of the list.
fn test_row(ray: Ray, row: u32) {
    tally.tests += 1u;
    let prim_id = prim_ids[row];
    let hit = intersect(ray, triangle_of(prim_id));
    if hit.is_hit && hit.t >= ray.t_min && hit.t <= found.t_far {
        offer(hit, i32(prim_id));
    }
}

// Test the triangles in the rows of the list from the first to before the end.
fn test_rows(ray: Ray, first: u32, end: u32) {
    for (var row = first; row < end; row++) {
        if is_full() || !spend_budget() {
            return;
        }
        test_row(ray, row);
    }
}
