// Brute force: all triangles in order (Foley 2005, section 4).

struct Tree {
    triangle_count: u32,
}

// The prim_ids of triangles that can be hit.
@group(1) @binding(0) var<storage, read> prim_ids: array<u32>;
// Vertices of all triangles: nine numbers each.
@group(1) @binding(1) var<storage, read> corners: array<f32>;

//! include "vertices.wgsl"

// Test the triangle in a row of the list.
fn test_row(ray: Ray, row: u32) {
    tally.tests += 1u;
    let prim_id = prim_ids[row];
    let hit = intersect(ray, triangle_of(prim_id));
    if hit.is_hit && hit.t >= ray.t_min && hit.t <= found.t_far {
        offer(hit, i32(prim_id));
    }
}

fn search(ray: Ray) {
    for (var row = 0u; row < params.tree.triangle_count; row++) {
        if is_full() || !spend_budget() {
            return;
        }
        test_row(ray, row);
    }
}
