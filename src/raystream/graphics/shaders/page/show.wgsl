// Shows the mean of the samples, encoded as sRGB.

struct Picture {
    width: u32,
    height: u32,
    unused: u32,
    // Factor on the light.
    exposure: f32,
}

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> sums: array<vec4f>;

fn encoded(linear: vec3f) -> vec3f {
    let small = 12.92 * linear;
    let large = 1.055 * pow(linear, vec3f(1.0 / 2.4)) - 0.055;
    return select(large, small, linear <= vec3f(0.0031308));
}

// A triangle that covers the canvas.
@vertex
fn cover(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((i << 1u) & 2u), f32(i & 2u));
    return vec4f(2.0 * corner - 1.0, 0.0, 1.0);
}

@fragment
fn show(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let place = min(vec2u(position.xy), vec2u(picture.width - 1u, picture.height - 1u));
    let sum = sums[place.y * picture.width + place.x];
    let mean = picture.exposure * sum.rgb / max(sum.a, 1.0);
    return vec4f(encoded(clamp(mean, vec3f(0.0), vec3f(1.0))), 1.0);
}
