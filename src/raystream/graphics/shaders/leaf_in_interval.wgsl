// The triangles of a leaf, block by block; hits count only in an interval of the ray.

//! include "leaf_block.wgsl"

// Test four triangles of a leaf, and offer their hits with t_in <= t < t_out: others belong to
// other leaves.
fn intersect_block(ray: Ray, block: u32, t_in: f32, t_out: f32) {
    for (var lane = 0u; lane < BLOCK_SIZE; lane++) {
        let prim_id = block_prim_id(block, lane);
        if prim_id < 0 || is_full() {
            return;
        }
        let hit = intersect(ray, block_triangle(block, lane));
        if hit.is_hit && hit.t >= t_in && hit.t < t_out && hit.t <= found.t_far {
            offer(hit, prim_id);
        }
    }
}

// Test a number of triangles, block by block, and count them.
fn test_blocks(ray: Ray, first: u32, triangle_count: u32, t_in: f32, t_out: f32) {
    var block = first;
    var left = triangle_count;
    while left != 0u && !is_full() && spend_budget() {
        let count = min(left, BLOCK_SIZE);
        tally.tests += count;
        intersect_block(ray, block, t_in, t_out);
        block += 1u;
        left -= count;
    }
}
