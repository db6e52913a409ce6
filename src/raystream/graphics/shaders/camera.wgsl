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

// A component of the vector to a place `across` and `down` from one unit ahead.
fn view_axis(view: View, axis: u32, across: Wide, down: Wide) -> Wide {
    let right = Wide(view.right[axis], view.right_low[axis]);
    let up = Wide(view.up[axis], view.up_low[axis]);
    let forward = Wide(view.forward[axis], view.forward_low[axis]);
    let beside = wide_difference(wide_product(right, across), wide_product(up, down));
    return wide_sum(beside, forward);
}

// Square root of a positive Wide: one Newton step from that of its float32.
fn wide_root(square: Wide) -> Wide {
    let guess = rounded(sqrt(square.high));
    let rest = wide_difference(square, exact_product(guess, guess));
    return ordered_sum(guess, rounded(rest.high / rounded(2.0 * guess)));
}

struct WideVector {
    x: Wide,
    y: Wide,
    z: Wide,
}

// Vector from the eye to a place of the image one unit ahead; columns right of and rows below the
// image's centre.
fn eye_vector(view: View, columns: Wide, rows: Wide) -> WideVector {
    let scale = Wide(view.scale, view.scale_low);
    let across = wide_product(columns, scale);
    let down = wide_product(rows, scale);
    return WideVector(
        view_axis(view, 0u, across, down),
        view_axis(view, 1u, across, down),
        view_axis(view, 2u, across, down),
    );
}

fn wide_unit(v: WideVector) -> vec3f {
    let square = wide_sum(
        wide_sum(wide_product(v.x, v.x), wide_product(v.y, v.y)),
        wide_product(v.z, v.z),
    );
    let length = wide_root(square);
    return vec3f(
        wide_quotient(v.x, length),
        wide_quotient(v.y, length),
        wide_quotient(v.z, length),
    );
}

// Unit vector from the eye through a pixel's centre: column + 1/2, row + 1/2.
fn eye_direction(view: View, pixel: vec2f) -> vec3f {
    let columns = Wide(pixel.x - 0.5 * view.width, 0.0);
    return wide_unit(eye_vector(view, columns, Wide(pixel.y - 0.5 * view.height, 0.0)));
}

// The power of two that brings the largest component into [1, 2), as ray.wgsl requires.
fn power_for(direction: vec3f) -> f32 {
    let size = abs(direction);
    let largest = max(max(size.x, size.y), size.z);
    let exponent = bitcast<u32>(largest) & 0x7f800000u;
    return bitcast<f32>(min(0x7f000000u - exponent, 0x7f000000u));
}
