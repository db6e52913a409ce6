// The triangles of a leaf: blocks of four slots, the last of which may be empty. As
// raystream/kernels/leaf_block.py.

//! include "leaf_block.wgsl"

// The prim_id of an empty slot. One below marks a triangle without finite vertices.
const NO_TRIANGLE: i32 = -1;

// The slots that are still to be tested.
struct Slots {
    first: u32,
    end: u32,
}

const NO_SLOTS = Slots(0u, 0u);

fn is_leaf(link: i32) -> bool {
    return link < 0;
}

// All slots of a leaf's blocks.
fn leaf_slots(link: i32) -> Slots {
    let bits = u32(~link);
    let first = bits >> 3u;
    visited(LEAF, first);
    tally.leaves += 1u;
    return Slots(BLOCK_SIZE * first, BLOCK_SIZE * (first + (bits & 7u) + 1u));
}

fn triangle_in(slot: u32) -> Triangle {
    return block_triangle(slot / BLOCK_SIZE, slot % BLOCK_SIZE);
}

fn prim_id_in(slot: u32) -> i32 {
    return block_prim_id(slot / BLOCK_SIZE, slot % BLOCK_SIZE);
}

// The first slot whose triangle the ray crosses, or the end.
fn next_crossed(ray: Ray, slots: Slots) -> u32 {
    var slot = slots.first;
    while slot < slots.end && spend_budget() {
        let prim_id = prim_id_in(slot);
        if prim_id == NO_TRIANGLE {
            slot += BLOCK_SIZE - slot % BLOCK_SIZE;
            continue;
        }
        tally.tests += 1u;
        if prim_id >= 0 && is_crossed(images_of(ray, triangle_in(slot))) {
            return slot;
        }
        slot += 1u;
    }
    return slots.end;
}

// Offer the hit of the triangle in a slot; the ray must cross it.
fn offer_slot(ray: Ray, slot: u32) {
    let hit = crossing(ray, triangle_in(slot));
    if hit.is_hit && hit.t >= ray.t_min && hit.t <= found.t_far {
        offer(hit, prim_id_in(slot));
    }
}
