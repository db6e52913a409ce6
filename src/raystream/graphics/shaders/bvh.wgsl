// The 8-wide bounding volume hierarchy: the steps of a traversal, and the traversal. As
// raystream/structures/bvh/steps.py and traversal.py, where the reasons are.

// Nodes of 16 vectors, and leaf blocks: as raystream/structures/bvh/layout.py says. The bits of
// floats and of integers.
@group(1) @binding(0) var<storage, read> nodes: array<vec4u>;
@group(1) @binding(1) var<storage, read> blocks: array<vec4u>;

const ROOT: i32 = 0;

//! include "visits.wgsl"
//! include "bvh_boxes.wgsl"
//! include "bvh_leaf.wgsl"
//! include "bvh_stack.wgsl"
//! include "bvh_root.wgsl"

struct Child {
    // False at the end of the search.
    is_found: bool,
    // A node, or a leaf; see is_leaf().
    link: i32,
}

// Pop the next child whose box the ray enters before t_far.
fn next_child() -> Child {
    let last_key = t_key(found.t_far);
    while has_entries() && spend_budget() {
        let entry = pop();
        if entry.key <= last_key {
            return Child(true, entry.link);
        }
    }
    return Child(false, ROOT);
}

// Push the children of a node that a ray enters, the nearest on top.
fn visit(ray: Ray, node: i32) {
    visited(BOXES, u32(node));
    tally.steps += 1u;
    var entered = entered_children(ray, node);
    for (var left = 8u; left != 0u; left--) {
        let key = largest_key(entered);
        if key == NO_KEY {
            return;
        }
        entered = without_key(entered, key);
        push(Entry(sort_key(key), link_of(entered, key)));
    }
}

// Traverse to the next leaf.
fn next_leaf(ray: Ray) -> Child {
    var child = next_child();
    while child.is_found && !is_leaf(child.link) && spend_budget() {
        visit(ray, child.link);
        child = next_child();
    }
    return child;
}

fn search_tree(ray: Ray) {
    begin_search(ray);
    var slots = NO_SLOTS;
    while !is_full() && spend_budget() {
        // Step 1: find the next triangle that the ray crosses, in this leaf or a later one, so that
        // the invocations of a subgroup do the long part of the test together.
        slots.first = next_crossed(ray, slots);
        while slots.first == slots.end {
            let leaf = next_leaf(ray);
            if !leaf.is_found {
                return;
            }
            slots = leaf_slots(leaf.link);
            slots.first = next_crossed(ray, slots);
        }
        // Step 2: intersect it.
        offer_slot(ray, slots.first);
        slots.first += 1u;
    }
}
