// Camera rays of a pinhole camera, through the pixels' centres (Purcell 2002, section 3.1.1).
//
// As raystream/scene/camera.py. Its float64 is a Wide here, so that directions agree to
// the last few bits.

struct View {
    // Local frame.
    eye: vec3f,
    // Depth of the near plane.
    near: f32,
    // Unit vectors of the image's axes; the height of a pixel, one unit ahead; pixels.
    right: vec3f,
    scale: f32,
    right_low: vec3f,
    scale_low: f32,
    up: vec3f,
    width: f32,
    up_low: vec3f,
    height: f32,
    forward: vec3f,
    // World units per local unit.
    inverse_scale: f32,
    forward_low: vec3f,
}

fn view_axis(right: Wide, up: Wide, forward: Wide, across: Wide, down: Wide) -> Wide {
    let beside = wide_difference(wide_product(right, across), wide_product(up, down));
    return wide_sum(beside, forward);
}

// Square root of a positive Wide: one Newton step from that of its float32.
fn wide_root(square: Wide) -> Wide {
    let guess = rounded(sqrt(square.high));
    let rest = wide_difference(square, exact_product(guess, guess));
    return ordered_sum(guess, rounded(rest.high / rounded(2.0 * guess)));
}

// Unit vector from the eye through a pixel's centre: column + 1/2, row + 1/2.
fn eye_direction(view: View, pixel: vec2f) -> vec3f {
    let scale = Wide(view.scale, view.scale_low);
    let across = times(pixel.x - 0.5 * view.width, scale);
    let down = times(pixel.y - 0.5 * view.height, scale);
    let x = view_axis(
        Wide(view.right.x, view.right_low.x),
        Wide(view.up.x, view.up_low.x),
        Wide(view.forward.x, view.forward_low.x),
        across,
        down,
    );
    let y = view_axis(
        Wide(view.right.y, view.right_low.y),
        Wide(view.up.y, view.up_low.y),
        Wide(view.forward.y, view.forward_low.y),
        across,
        down,
    );
    let z = view_axis(
        Wide(view.right.z, view.right_low.z),
        Wide(view.up.z, view.up_low.z),
        Wide(view.forward.z, view.forward_low.z),
        across,
        down,
    );
    let square = wide_sum(wide_sum(wide_product(x, x), wide_product(y, y)), wide_product(z, z));
    let length = wide_root(square);
    return vec3f(wide_quotient(x, length), wide_quotient(y, length), wide_quotient(z, length));
}

// The power of two that brings the largest component into [1, 2), as ray.wgsl requires.
fn power_for(direction: vec3f) -> f32 {
    let size = abs(direction);
    let largest = max(max(size.x, size.y), size.z);
    let exponent = bitcast<u32>(largest) & 0x7f800000u;
    return bitcast<f32>(min(0x7f000000u - exponent, 0x7f000000u));
}
