// Brute force as Foley did it: each draw has its triangle in constants, so that no ray reads memory
// for it (Foley 2005, section 4). Replaces brute.wgsl where a program tests one triangle.

struct Tree {
    a: vec3f,
    triangle_count: u32,
    b: vec3f,
    prim_id: i32,
    c: vec3f,
}

// Test the triangle in the constants: that of the row.
fn test_row(ray: Ray, row: u32) {
    tally.tests += 1u;
    let hit = intersect(ray, Triangle(params.tree.a, params.tree.b, params.tree.c));
    if hit.is_hit && hit.t >= ray.t_min && hit.t <= found.t_far {
        offer(hit, params.tree.prim_id);
    }
}
