// Brute force over instances: every triangle of each. Replaces brute_rows.wgsl. As
// raystream/geometry/instances/traversal.py.

struct Tree {
    // The row of `places` where objects begin.
    object_at: u32,
    instance_count: u32,
}

//! include "instances/object_ray.wgsl"

// Search the instances of the ray's world, and those in all worlds.
fn search(ray: Ray) {
    for (var number = 0u; number < params.tree.instance_count; number++) {
        if is_full() || !spend_budget() {
            return;
        }
        let about = places[INSTANCE_ROWS * number + 6u];
        let world = bitcast<i32>(about.z);
        if world >= 0 && world != world_ray.world {
            continue;
        }
        let object = object_of(about.x);
        let moved_ray = enter_instance(number, object);
        if moved_ray.t_min <= moved_ray.t_max {
            test_rows(moved_ray, u32(object.first), u32(object.end));
        }
        leave_instance();
    }
}
