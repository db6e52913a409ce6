// A full-screen triangle runs a fragment program over all rays: a texel is a ray, a texture a
// stream of records of four words.

//! include "fullscreen.wgsl"

// The texel of the fragment's ray.
fn texel_at(position: vec4f) -> vec2i {
    return vec2i(position.xy);
}
