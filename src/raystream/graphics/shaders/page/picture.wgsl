// An image on a canvas: sums over the samples of each pixel, and a triangle that covers the canvas.

struct Picture {
    width: u32,
    height: u32,
    // Of sums, for one number per pixel.
    channel: u32,
    // Factor on the light.
    exposure: f32,
}

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> sums: array<vec4f>;

@vertex
fn cover(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32((i << 1u) & 2u), f32(i & 2u));
    return vec4f(2.0 * corner - 1.0, 0.0, 1.0);
}

// The mean of a pixel's samples.
fn mean_of(pixel: u32) -> vec3f {
    let sum = sums[pixel];
    return sum.rgb / max(sum.a, 1.0);
}

fn pixel_at(position: vec4f) -> u32 {
    let place = min(vec2u(position.xy), vec2u(picture.width - 1u, picture.height - 1u));
    return place.y * picture.width + place.x;
}
