// Trees over instances, whose leaves continue the search in an object's tree. Replaces bvh_root.wgsl.
// As raystream/geometry/instances/traversal.py.
//
// All trees are in one array, and links are rows of it, so that one traversal serves both levels: the
// object's is above what waits on the stack.

struct Tree {
    // Rows of `places`, where objects and roots of trees begin.
    object_at: u32,
    root_at: u32,
    // Trees: one for each world, and that of the instances in all worlds.
    tree_count: u32,
}

//! include "instances/object_ray.wgsl"

// The root of the tree that is searched, or -1; and the stack's size before.
var<private> root: i32;
var<private> stack_bottom: u32;

fn begin_search(ray: Ray) {
    if root >= 0 && ray.t_min <= ray.t_max {
        push(Entry(0u, root));
    }
}

fn has_entries() -> bool {
    return stack_top != stack_bottom;
}

// The root of a tree over instances; -1 if it is empty.
fn root_of(tree: u32) -> i32 {
    return bitcast<i32>(places[params.tree.root_at + tree / 4u][tree % 4u]);
}

// Search the instances of the ray's world, then those in all worlds.
fn search(ray: Ray) {
    stack_top = 0u;
    stack_bottom = 0u;
    let worlds = params.tree.tree_count - 1u;
    if world_ray.world >= 0 {
        root = root_of(u32(world_ray.world));
        begin_search(ray);
    }
    var is_last = false;
    while !is_full() && spend_budget() {
        let leaf = next_leaf(ray);
        if !leaf.is_found {
            if is_last {
                return;
            }
            is_last = true;
            root = root_of(worlds);
            begin_search(ray);
            continue;
        }
        let number = u32(~leaf.link) >> 3u;
        let object = object_of(places[INSTANCE_ROWS * number + 6u].x);
        root = object.first;
        stack_bottom = stack_top;
        search_tree(enter_instance(number, object));
        leave_instance();
        stack_bottom = 0u;
    }
}
