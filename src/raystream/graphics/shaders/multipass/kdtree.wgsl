// Foley's kernels: Initialize, Down, Leaf, Intersect, Continue, Up (Foley 2005, section 3.3). As
// raystream/machines/steps/kdtree.py.

//! include "multipass/frame.wgsl"

struct Place {
    state: KdState,
    // Triangles of its leaf that are still to be tested, and their first block.
    triangles: KdLeaf,
}

const NO_TRIANGLES = KdLeaf(0u, 0u);

fn place_at(texel: vec2i) -> Place {
    let place = textureLoad(places, texel, 0);
    let span = textureLoad(spans, texel, 0);
    let state = KdState(place.x, span.x, span.y, span.z, 0u, false);
    return Place(state, KdLeaf(place.y, place.z));
}

fn end_at(texel: vec2i, waits_for: u32, at: Place) -> Targets {
    let place = vec4u(at.state.node, at.triangles.block, at.triangles.triangle_count, 0u);
    let span = vec4f(at.state.t_in, at.state.t_out, at.state.t_end, 0.0);
    return end_kernel(texel, waits_for, place, span);
}

// The next state at a node.
fn downward(state: KdState) -> u32 {
    return select(TRAVERSING, AT_LEAF, is_at_leaf(state));
}

// Start at the root.
@fragment
fn begin_at_root(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, STARTING) {
        return nothing();
    }
    run_count = 1u;
    let ray = ray_at(texel);
    found.t_far = ray.t_max;
    let state = initialize(ray);
    if !(ray.t_min <= ray.t_max) || !is_active(state) {
        return end_kernel(texel, end_state(), vec4u(), vec4f());
    }
    return end_at(texel, downward(state), Place(state, NO_TRIANGLES));
}

// Descend to a child.
@fragment
fn descend_rays(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, TRAVERSING) {
        return nothing();
    }
    let line = plane_ray(ray_at(texel));
    var state = place_at(texel).state;
    var waits_for = TRAVERSING;
    for (var i = 0u; i < TRAVERSAL_STEPS && waits_for == TRAVERSING; i++) {
        if !count_step() {
            waits_for = DONE;
            break;
        }
        tally.steps += 1u;
        state = descend(line, state);
        waits_for = downward(state);
    }
    return end_at(texel, waits_for, Place(state, NO_TRIANGLES));
}

// Find the triangles of a leaf.
@fragment
fn look_at_leaf(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, AT_LEAF) {
        return nothing();
    }
    run_count = 1u;
    tally.leaves += 1u;
    let state = place_at(texel).state;
    let triangles = leaf(state);
    let waits_for = select(INTERSECTING, CONTINUING, triangles.triangle_count == 0u);
    return end_at(texel, waits_for, Place(state, triangles));
}

// Test a block of up to four triangles.
@fragment
fn intersect_leaf(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, INTERSECTING) {
        return nothing();
    }
    let ray = ray_at(texel);
    var at = place_at(texel);
    var waits_for = INTERSECTING;
    for (var i = 0u; i < INTERSECTIONS && waits_for == INTERSECTING; i++) {
        if !count_step() {
            waits_for = DONE;
            break;
        }
        let count = min(at.triangles.triangle_count, BLOCK_SIZE);
        tally.tests += count;
        intersect_block(ray, at.triangles.block, at.state.t_in, at.state.t_out);
        at.triangles.block += 1u;
        at.triangles.triangle_count -= count;
        if is_full() {
            waits_for = end_state();
        } else if at.triangles.triangle_count == 0u {
            waits_for = CONTINUING;
        }
    }
    return end_at(texel, waits_for, at);
}

// Continue after a leaf, unless the search is over: hits in later leaves are not before this one's
// end.
@fragment
fn continue_rays(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, CONTINUING) {
        return nothing();
    }
    let state = place_at(texel).state;
    if !count_step() || is_over(state.t_out) || state.t_out >= state.t_end {
        return end_at(texel, end_state(), Place(state, NO_TRIANGLES));
    }
    let next = continue_search(state);
    if next.is_backtracking {
        tally.backtracks += 1u;
        return end_at(texel, BACKTRACKING, Place(next, NO_TRIANGLES));
    }
    tally.restarts += 1u;
    return end_at(texel, downward(next), Place(next, NO_TRIANGLES));
}

// Climb to the parent.
@fragment
fn backtrack_rays(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, BACKTRACKING) {
        return nothing();
    }
    let line = plane_ray(ray_at(texel));
    var state = place_at(texel).state;
    var waits_for = BACKTRACKING;
    for (var i = 0u; i < TRAVERSAL_STEPS && waits_for == BACKTRACKING; i++) {
        if !count_step() {
            waits_for = DONE;
            break;
        }
        tally.backtrack_steps += 1u;
        state = backtrack(line, state);
        if !state.is_backtracking {
            waits_for = downward(state);
        }
    }
    return end_at(texel, waits_for, Place(state, NO_TRIANGLES));
}
