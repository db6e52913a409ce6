// Programs before and after kernels: they start rays, copy the records that a kernel has written
// from scratch textures to the streams, and set the next states of its rays. They read the scratch
// textures.

//! include "fragment/texel.wgsl"
//! include "fragment/targets.wgsl"
//! include "multipass/states.wgsl"

// params.wgsl up to the structure's Tree.
struct Params {
    max_coordinate: f32,
    zero: u32,
    ray_count: u32,
    row_size: u32,
    budget: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(4) var states: texture_2d<u32>;
@group(0) @binding(5) var founds: texture_2d<f32>;
@group(0) @binding(6) var places: texture_2d<u32>;
@group(0) @binding(7) var spans: texture_2d<f32>;

// As in ray.wgsl and search_state.wgsl.
const FAR: f32 = 0x1.fffffep+127;
const MISS: i32 = -1;

// Constant of the pipeline: see classify().
override NEXT: u32 = 0u;

// Start all rays; texels without a ray never start.
@fragment
fn begin(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if u32(texel.y) * params.row_size + u32(texel.x) >= params.ray_count {
        discard;
    }
    return targets_of(
        vec4u(STARTING, 0u, bitcast<u32>(MISS), params.budget),
        vec4f(FAR, 0.0, 0.0, FAR),
        vec4u(),
        vec4f(),
    );
}

@fragment
fn commit(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    return targets_of(
        textureLoad(states, texel, 0),
        textureLoad(founds, texel, 0),
        textureLoad(places, texel, 0),
        textureLoad(spans, texel, 0),
    );
}

// Keep the fragments of rays with one next state, which the stencil operation sets.
@fragment
fn classify(@builtin(position) position: vec4f) {
    if textureLoad(states, texel_at(position), 0).x != NEXT {
        discard;
    }
}

// Keep all fragments: rays in one state, which the stencil operation moves to another.
@fragment
fn resume(@builtin(position) position: vec4f) {}
