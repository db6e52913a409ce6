// The triangles of a leaf: blocks of four slots, in which the last ones may be empty. As
// raystream/structures/bvh/block.py.

const BLOCK: u32 = 10u;
const IDS: u32 = 9u;
const BLOCK_SIZE: u32 = 4u;

// The prim_id of an empty slot. One below is that of a triangle that cannot be hit any more.
const NO_TRIANGLE: i32 = -1;

struct Slots {
    first: u32,
    end: u32,
}

fn is_leaf(link: i32) -> bool {
    return link < 0;
}

// All slots of a leaf's blocks.
fn leaf_slots(link: i32) -> Slots {
    let bits = u32(~link);
    let first = bits >> 3u;
    return Slots(BLOCK_SIZE * first, BLOCK_SIZE * (first + (bits & 7u) + 1u));
}

fn leaf_number(at: u32, lane: u32) -> f32 {
    return bitcast<f32>(leaves[at][lane]);
}

fn leaf_corner(at: u32, lane: u32) -> vec3f {
    return vec3f(leaf_number(at, lane), leaf_number(at + 1u, lane), leaf_number(at + 2u, lane));
}

// Test the triangle in a slot, if there is one; returns the slot that is next.
fn test_slot(ray: Ray, slot: u32) -> u32 {
    let at = BLOCK * (slot / BLOCK_SIZE);
    let lane = slot % BLOCK_SIZE;
    let prim_id = bitcast<i32>(leaves[at + IDS][lane]);
    if prim_id == NO_TRIANGLE {
        return slot - lane + BLOCK_SIZE;
    }
    tally.tests += 1u;
    if prim_id >= 0 {
        let triangle = Triangle(
            leaf_corner(at, lane),
            leaf_corner(at + 3u, lane),
            leaf_corner(at + 6u, lane),
        );
        let hit = intersect(ray, triangle);
        if hit.is_hit && hit.t >= ray.t_min && hit.t <= found.t_far {
            offer(hit, prim_id);
        }
    }
    return slot + 1u;
}
