// Leaf blocks of four triangles, 160 bytes: four x of the first corners, then their y and z, the
// second corners, the third ones, and the numbers of the triangles, MISS where there is none. As
// raystream/structures/bvh/block.py; needs `blocks`, as vectors of four words.

const BLOCK_ROWS: u32 = 10u;
const BLOCK_SIZE: u32 = 4u;

fn block_corner(block: u32, corner: u32, lane: u32) -> vec3f {
    let row = block * BLOCK_ROWS + 3u * corner;
    return bitcast<vec3f>(vec3u(blocks[row][lane], blocks[row + 1u][lane], blocks[row + 2u][lane]));
}

fn block_triangle(block: u32, lane: u32) -> Triangle {
    return Triangle(
        block_corner(block, 0u, lane),
        block_corner(block, 1u, lane),
        block_corner(block, 2u, lane),
    );
}

fn block_prim_id(block: u32, lane: u32) -> i32 {
    return bitcast<i32>(blocks[block * BLOCK_ROWS + 9u][lane]);
}

// Test four triangles of a leaf, and offer their hits with t_in <= t < t_out: others are another
// leaf's.
fn intersect_block(ray: Ray, block: u32, t_in: f32, t_out: f32) {
    for (var lane = 0u; lane < BLOCK_SIZE; lane++) {
        let prim_id = block_prim_id(block, lane);
        if prim_id < 0 || is_enough() {
            return;
        }
        let hit = intersect(ray, block_triangle(block, lane));
        if hit.is_hit && hit.t >= t_in && hit.t < t_out && hit.t <= found.t_far {
            offer(hit, prim_id);
        }
    }
}

// Test so many triangles, a block after the other, and count them.
fn test_blocks(ray: Ray, first: u32, triangle_count: u32, t_in: f32, t_out: f32) {
    var block = first;
    var left = triangle_count;
    while left != 0u && !is_enough() && spend() {
        let count = min(left, BLOCK_SIZE);
        tally.tests += count;
        intersect_block(ray, block, t_in, t_out);
        block += 1u;
        left -= count;
    }
}
