// What all programs share but the one that traces.

struct Params {
    // Largest absolute coordinate of the scene, local frame.
    max_coordinate: f32,
    // 0: see exact.wgsl.
    zero: u32,
    // Largest coordinate of the frame's origin, in local lengths.
    world_reach: f32,
    // Rays of which no colour weighs more end.
    min_weight: f32,
    // Radiance from everywhere, that nothing blocks.
    ambient: vec3f,
    // The light that is looked at.
    number: u32,
    // What rays that miss see.
    background: vec3f,
    // Whether any mesh has attributes of its vertices: 0 or 1.
    has_attributes: u32,
    view: View,
}

@group(0) @binding(0) var<uniform> params: Params;

// What a ray through an edge meets: every triangle.
const SURFACES: bool = false;

//! include "exact.wgsl"
//! include "camera.wgsl"
