// What all fragment programs share: a texel is a ray, a texture a stream of records of four words.
//
// Purcell 2002, section 3: a kernel is a fragment program, run by drawing something that covers
// the screen. Which rays it runs on, the stencil test says. It reads streams as textures, and
// writes render targets.

struct Params {
    // Largest absolute coordinate of the scene.
    extreme: f32,
    // 0: see exact.wgsl.
    zero: u32,
    ray_count: u32,
    // Rays in a row of the textures.
    row_size: u32,
    // Steps and tests before a search counts as endless.
    budget: u32,
    @align(16) tree: Tree,
}

@group(0) @binding(0) var<uniform> params: Params;
// Origin and t_min; direction and t_max.
@group(0) @binding(1) var ray_origins: texture_2d<f32>;
@group(0) @binding(2) var ray_directions: texture_2d<f32>;
// The first of the ray's rows, and how many hits are wanted.
@group(0) @binding(3) var wanted: texture_2d<u32>;

//! include "exact.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "found.wgsl"
//! include "tally.wgsl"
//! include "fragment/rows.wgsl"
//! include "fragment/counting.wgsl"
//! include "fragment/texels.wgsl"

// A triangle that covers the screen: its corners are (-1, -1), (3, -1) and (-1, 3).
@vertex
fn cover(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4f {
    let place = vec2f(f32((corner << 1u) & 2u), f32(corner & 2u));
    return vec4f(2.0 * place - vec2f(1.0), 0.0, 1.0);
}

// The texel of the fragment's ray, and the ray's number.
fn texel_at(position: vec4f) -> vec2i {
    return vec2i(position.xy);
}

fn ray_number(texel: vec2i) -> u32 {
    return u32(texel.y) * params.row_size + u32(texel.x);
}

fn ray_at(texel: vec2i) -> Ray {
    let from_ = textureLoad(ray_origins, texel, 0);
    let to = textureLoad(ray_directions, texel, 0);
    return set_up_ray(from_.xyz, to.xyz, from_.w, to.w);
}
