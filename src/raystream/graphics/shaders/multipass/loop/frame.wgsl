// Shared code of the kernels that give pixels their rays: eye rays, and shading. They are drawn like
// the kernels of a traversal, to other streams.

//! include "fragment/texel.wgsl"
//! include "multipass/states.wgsl"
//! include "multipass/loop/targets.wgsl"

// params.wgsl up to the structure's Tree.
struct Params {
    max_coordinate: f32,
    zero: u32,
    ray_count: u32,
    row_size: u32,
    budget: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var origins: texture_2d<f32>;
@group(0) @binding(2) var directions: texture_2d<f32>;
@group(0) @binding(3) var pixels: texture_2d<u32>;
@group(0) @binding(4) var states: texture_2d<u32>;
@group(0) @binding(5) var founds: texture_2d<f32>;
@group(0) @binding(6) var weights: texture_2d<u32>;
@group(0) @binding(7) var lights_found: texture_2d<f32>;
@group(0) @binding(8) var paths: texture_2d<u32>;

// A ray through an edge hits all its triangles.
const SURFACES: bool = false;
const MISS: i32 = -1;

// The number of a texel's pixel in its band.
fn pixel_number(texel: vec2i) -> u32 {
    return u32(texel.y) * params.row_size + u32(texel.x);
}
