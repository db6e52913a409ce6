// Uniforms of both passes.

struct Params {
    // Largest absolute coordinate of the scene.
    max_coordinate: f32,
    // 0: see exact.wgsl.
    zero: u32,
    @align(16) view: View,
}

@group(0) @binding(0) var<uniform> params: Params;

// A ray through an edge hits all its triangles.
const SURFACES: bool = false;

//! include "exact.wgsl"
//! include "camera.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "vertices.wgsl"
