// A fragment program runs over all rays by drawing a triangle that covers the screen: a texel is
// a ray, a texture a stream of records of four words.

// It fills the upper left half of a viewport that is twice as wide and as high as the screen; see
// streams/programs.py.
@vertex
fn cover(@builtin(vertex_index) corner: u32) -> @builtin(position) vec4f {
    let place = vec2f(f32((corner << 1u) & 2u), f32(corner & 2u));
    return vec4f(place.x - 1.0, 1.0 - place.y, 0.0, 1.0);
}

// The texel of the fragment's ray.
fn texel_at(position: vec4f) -> vec2i {
    return vec2i(position.xy);
}
