// What all pixels of a band share. As raystream/graphics/rendering/uniforms.py.

struct Shading {
    view: View,
    // What is left of the eye's position in float32; radius of the lens, 0 for a pinhole.
    eye_low: vec3f,
    radius: f32,
    // The scene's box, local frame; distance of the plane in focus, likewise.
    low: vec3f,
    focus: f32,
    high: vec3f,
    // Largest coordinate of the frame's origin, in local lengths.
    world_reach: f32,
    // Ambient radiance, without occlusion.
    ambient: vec3f,
    // Paths end when no channel of their weight is greater.
    min_weight: f32,
    // Radiance of rays that miss.
    background: vec3f,
    // Bound on each channel of indirect light.
    clamp: f32,
    // The first pixel of the band; the sample, and the seed of its numbers.
    first_pixel: u32,
    sample: u32,
    seed: u32,
    // Pixels of the band.
    pixel_count: u32,
    // Shadow rays of a path, and lights.
    shadow_count: u32,
    light_count: u32,
    // Paths of a pixel and bounce.
    room: u32,
    // Whether any mesh has vertex attributes: 0 or 1.
    has_attributes: u32,
    // Lights of path.wgsl: points, suns, and triangles of area lights.
    point_count: u32,
    sun_count: u32,
    patch_count: u32,
    padding: u32,
    // Columns of a matrix, see sampler.wgsl.
    quads: array<vec4u, 8>,
}

@group(1) @binding(0) var<uniform> shading: Shading;

// Constants of the pipeline: the bounce whose paths spawn none; the index of the sampler; whether
// camera rays are spread over the pixel; whether shadow rays decide about light.
override LAST_BOUNCE: u32 = 0u;
override SAMPLER: u32 = 0u;
override SPREADS: bool = false;
override CASTS_SHADOWS: bool = true;

//! include "exact.wgsl"
//! include "camera.wgsl"
//! include "ray.wgsl"
