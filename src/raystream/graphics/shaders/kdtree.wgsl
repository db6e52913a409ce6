// The kd-tree (Foley 2005). As raystream/structures/kdtree/traversal.py.

struct Tree {
    low: vec3f,
    root: u32,
    high: vec3f,
    // 0 in an empty tree.
    node_count: u32,
}

// Leaf blocks; see leaf_in_interval.wgsl. The layout has the nodes.
@group(1) @binding(1) var<storage, read> blocks: array<vec4u>;

//! include "leaf_in_interval.wgsl"
//! include "plane_distances.wgsl"
//! include "visits.wgsl"
//! include "kdtree/state.wgsl"
//! include "kdtree/compact.wgsl"
//! include "kdtree/steps.wgsl"
//! include "kdtree/stack.wgsl"

fn search(ray: Ray) {
    var state = initialize(ray);
    if !is_active(state) {
        return;
    }
    let line = plane_ray(ray);
    while spend_budget() {
        while !is_at_leaf(state) && spend_budget() {
            visited(SPLIT, state.node);
            state = descend(line, state);
            tally.steps += 1u;
        }
        visited(LEAF, state.node);
        tally.leaves += 1u;
        let triangles = leaf(state);
        test_blocks(ray, triangles.block, triangles.triangle_count, state.t_in, state.t_out);
        // Hits in later leaves are not before this one's end.
        if is_over(state.t_out) || state.t_out >= state.t_end {
            return;
        }
        state = continue_counted(line, state);
    }
}
