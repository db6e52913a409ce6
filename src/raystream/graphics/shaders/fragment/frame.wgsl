// Shared declarations of fragment programs: the rays of a query, as textures.

//! include "params.wgsl"

// Origin and t_min; direction and t_max.
@group(0) @binding(1) var ray_origins: texture_2d<f32>;
@group(0) @binding(2) var ray_directions: texture_2d<f32>;
// First row and capacity of the ray.
@group(0) @binding(3) var wanted: texture_2d<u32>;

//! include "exact.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "search_state.wgsl"
//! include "tally.wgsl"
//! include "fragment/texel.wgsl"
//! include "fragment/hit_rows.wgsl"
//! include "fragment/counters.wgsl"
//! include "fragment/targets.wgsl"

// The index of a texel's ray.
fn ray_number(texel: vec2i) -> u32 {
    return u32(texel.y) * params.row_size + u32(texel.x);
}

fn ray_at(texel: vec2i) -> Ray {
    let from_ = textureLoad(ray_origins, texel, 0);
    let to = textureLoad(ray_directions, texel, 0);
    return set_up_ray(from_.xyz, to.xyz, from_.w, to.w);
}
