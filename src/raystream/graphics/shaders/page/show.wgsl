// Shows the mean of the samples, encoded as sRGB.

//! include "page/picture.wgsl"

fn encoded(linear: vec3f) -> vec3f {
    let small = 12.92 * linear;
    let large = 1.055 * pow(linear, vec3f(1.0 / 2.4)) - 0.055;
    return select(large, small, linear <= vec3f(0.0031308));
}

@fragment
fn show(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let mean = picture.exposure * mean_of(pixel_at(position));
    return vec4f(encoded(clamp(mean, vec3f(0.0), vec3f(1.0))), 1.0);
}
