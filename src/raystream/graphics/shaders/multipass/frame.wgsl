// What the kernels of the multipass machine share: where a ray's records are read, and written.
//
// A kernel has no discard: with one, the stencil test could not come before it. It writes scratch
// textures, because a pass cannot read what it writes; see commit.wgsl.

// Of the pipeline: the kernel's number, and how many steps and tests of a ray one run does.
override KERNEL: u32 = 0u;
override TRAVERSAL_STEPS: u32 = 1u;
override INTERSECTIONS: u32 = 1u;

//! include "fragment/frame.wgsl"
//! include "multipass/states.wgsl"

// See targets.wgsl.
@group(0) @binding(4) var states: texture_2d<u32>;
@group(0) @binding(5) var founds: texture_2d<f32>;
@group(0) @binding(6) var places: texture_2d<u32>;
@group(0) @binding(7) var spans: texture_2d<f32>;

// How often the kernel did what it does, on this ray.
var<private> run_count: u32;

// Read what a ray has found. False if the ray does not wait for the kernel: the stencil test keeps
// such a fragment from the targets, but it may come too late to keep it from buffers.
fn begin_kernel(texel: vec2i, waits_for: u32) -> bool {
    let state = textureLoad(states, texel, 0);
    let hit = textureLoad(founds, texel, 0);
    let wish = textureLoad(wanted, texel, 0);
    found = SearchState(hit.w, state.y, wish.y, wish.x, hit.x, hit.y, hit.z, bitcast<i32>(state.z), state.w);
    return state.x == waits_for;
}

// What a fragment writes that does not count.
fn nothing() -> Targets {
    return targets_of(vec4u(), vec4f(), vec4u(), vec4f());
}

// Count a step: false if the ray's budget is spent, and its search must end.
fn tick() -> bool {
    run_count += 1u;
    return spend();
}

// What a ray waits for whose search has ended.
fn end_of_search() -> u32 {
    if QUERY == FIRST_HIT {
        return select(SHADING, DONE, found.prim_id == MISS);
    }
    return select(SHADING, DONE, QUERY == COUNT_HITS || found.count == 0u);
}

// Write what a ray has found, where it is, and what it waits for.
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
