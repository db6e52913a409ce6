// What comes before and after kernels, whatever these do: rays begin; the records that a kernel has
// written are copied from scratch textures to the streams, and its rays are told what they wait
// for next. The textures that are read are the scratch ones.

//! include "fragment/texel.wgsl"
//! include "fragment/targets.wgsl"
//! include "multipass/states.wgsl"

// What params.wgsl has before the structure's Tree.
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

// As ray.wgsl and search_state.wgsl have them.
const FAR: f32 = 0x1.fffffep+127;
const MISS: i32 = -1;

// Of the pipeline: see classify().
override NEXT: u32 = 0u;

// All rays begin; texels that are no ray's never do.
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

// Keep the fragments whose rays go on to one state: the stencil operation then takes them there.
@fragment
fn classify(@builtin(position) position: vec4f) {
    if textureLoad(states, texel_at(position), 0).x != NEXT {
        discard;
    }
}
