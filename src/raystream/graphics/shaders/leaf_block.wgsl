// A leaf block of four triangles, 160 bytes: four x of the first vertices, then their y and z, the
// second vertices, the third ones, and the prim_ids. As
// raystream/kernels/leaf_block.py; needs `blocks`, as vectors of four words.

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

// The prim_id of a triangle; negative in a slot that cannot be hit.
fn block_prim_id(block: u32, lane: u32) -> i32 {
    return bitcast<i32>(blocks[block * BLOCK_ROWS + 9u][lane]);
}
