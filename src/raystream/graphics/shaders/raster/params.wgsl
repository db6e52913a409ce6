// What both passes share.

struct Params {
    // Largest absolute coordinate of the scene.
    max_coordinate: f32,
    // 0: see exact.wgsl.
    zero: u32,
    @align(16) view: View,
}

@group(0) @binding(0) var<uniform> params: Params;

// What a ray through an edge meets: every triangle.
const SURFACES: bool = false;

//! include "exact.wgsl"
//! include "camera.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "vertices.wgsl"
