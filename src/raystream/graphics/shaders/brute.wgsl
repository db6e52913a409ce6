// Every triangle, one after another (Foley 2005, section 4).

struct Tree {
    triangle_count: u32,
}

// Numbers of the triangles that can be hit.
@group(1) @binding(0) var<storage, read> prim_ids: array<u32>;
// Corners of all triangles: nine numbers each.
@group(1) @binding(1) var<storage, read> corners: array<f32>;

//! include "corners.wgsl"

fn search(ray: Ray) {
    for (var i = 0u; i < params.tree.triangle_count; i++) {
        if is_enough() || !spend() {
            return;
        }
        tally.tests += 1u;
        let prim_id = prim_ids[i];
        let hit = intersect(ray, triangle_of(prim_id));
        if hit.is_hit && hit.t >= ray.t_min && hit.t <= found.t_far {
            offer(hit, i32(prim_id));
        }
    }
}
