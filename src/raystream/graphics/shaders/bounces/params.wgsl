// Uniforms of all programs but the one that traces.

struct Params {
    // Largest absolute coordinate of the scene, local frame.
    max_coordinate: f32,
    // 0: see exact.wgsl.
    zero: u32,
    // Largest coordinate of the frame's origin, in local lengths.
    world_reach: f32,
    // Paths end when no channel of their weight is greater.
    min_weight: f32,
    // Ambient radiance, without occlusion.
    ambient: vec3f,
    // Index of the light.
    number: u32,
    // Radiance of rays that miss.
    background: vec3f,
    // Whether any mesh has vertex attributes: 0 or 1.
    has_attributes: u32,
    view: View,
}

@group(0) @binding(0) var<uniform> params: Params;

// A ray through an edge hits all its triangles.
const SURFACES: bool = false;

//! include "exact.wgsl"
//! include "camera.wgsl"
