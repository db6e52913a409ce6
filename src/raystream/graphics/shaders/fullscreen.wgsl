// A full-screen triangle: drawing it runs a kernel on every texel. It fills
// the upper left half of a viewport twice as wide and as high; see fragment_program.py.

@vertex
fn cover(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((i << 1u) & 2u), f32(i & 2u));
    return vec4f(corner.x - 1.0, 1.0 - corner.y, 0.0, 1.0);
}
