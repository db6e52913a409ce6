// A fragment program runs over all rays by drawing a triangle that covers the screen: a texel is
// a ray, a texture a stream of records of four words.

// Its corners are (-1, -1), (3, -1) and (-1, 3).
@vertex
fn cover(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4f {
    let place = vec2f(f32((corner << 1u) & 2u), f32(corner & 2u));
    return vec4f(2.0 * place - vec2f(1.0), 0.0, 1.0);
}

// The texel of the fragment's ray.
fn texel_at(position: vec4f) -> vec2i {
    return vec2i(position.xy);
}
