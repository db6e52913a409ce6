// Shared code of the multipass kernels: reading and writing a ray's records.
//
// A kernel has no discard: with one, the stencil test could not come first. It writes scratch
// textures, because a pass cannot read what it writes; see commit.wgsl.

// Constants of the pipeline: the kernel's index, and steps and tests per ray and run.
override KERNEL: u32 = 0u;
override TRAVERSAL_STEPS: u32 = 1u;
override INTERSECTIONS: u32 = 1u;

// Whether rays without hits are shaded, too: in a renderer's loop.
override SHADES_ALL: bool = false;

//! include "fragment/frame.wgsl"
//! include "multipass/states.wgsl"

// See targets.wgsl.
@group(0) @binding(4) var states: texture_2d<u32>;
@group(0) @binding(5) var founds: texture_2d<f32>;
@group(0) @binding(6) var places: texture_2d<u32>;
@group(0) @binding(7) var spans: texture_2d<f32>;

// Steps of the kernel on this ray.
var<private> run_count: u32;

// Read a ray's search state. False if the ray does not wait for the kernel: the stencil test keeps
// such a fragment from the targets, but may come too late to keep it from buffers.
fn begin_kernel(texel: vec2i, waits_for: u32) -> bool {
    let state = textureLoad(states, texel, 0);
    let hit = textureLoad(founds, texel, 0);
    let wish = textureLoad(wanted, texel, 0);
    found = SearchState(hit.w, state.y, wish.y, wish.x, hit.x, hit.y, hit.z, bitcast<i32>(state.z), state.w);
    if waits_for == STARTING {
        begin_search_state(FAR, wish.x, wish.y);
    }
    return state.x == waits_for;
}

// Targets of a fragment that is not drawn.
fn nothing() -> Targets {
    return targets_of(vec4u(), vec4f(), vec4u(), vec4f());
}

// Count a step; false if the ray's budget is spent, and its search must end.
fn count_step() -> bool {
    run_count += 1u;
    return spend_budget();
}

// The state of a ray whose search has ended.
fn end_state() -> u32 {
    if SHADES_ALL {
        return SHADING;
    }
    if QUERY == FIRST_HIT {
        return select(SHADING, DONE, found.prim_id == MISS);
    }
    return select(SHADING, DONE, QUERY == COUNT_HITS || found.count == 0u);
}

// Write a ray's search state, traversal state, and next state.
fn end_kernel(texel: vec2i, state: u32, place: vec4u, span: vec4f) -> Targets {
    let number = ray_number(texel);
    add_tallies(number);
    add_runs(number, KERNEL, run_count);
    return targets_of(
        vec4u(state, found.count, bitcast<u32>(found.prim_id), found.budget),
        vec4f(found.t, found.u, found.v, found.t_far),
        place,
        span,
    );
}

//! include "multipass/shade.wgsl"
