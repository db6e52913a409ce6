// Gives each pixel its eye ray (Purcell 2002, section 3.1.1). As
// raystream/rendering/shading/camera_rays.py, with Wide for float64.

//! include "rendering/shading.wgsl"
//! include "rendering/sampler.wgsl"
//! include "rendering/warp.wgsl"

// An origin beyond is advanced to the scene's box; see raystream/kernels/ray.py.
const FAR_OUTSIDE: f32 = 4.0;

struct Eye {
    x: Wide,
    y: Wide,
    z: Wide,
    is_active: bool,
}

fn outside_by(o: f32, low: f32, high: f32) -> f32 {
    return max(low - o, o - high);
}

// The interval of a line between two planes that a margin moves apart.
fn wide_crossing(o: Wide, d: f32, low: f32, high: f32) -> Interval {
    let margin = params.max_coordinate;
    let to_low = wide_difference(exact_sum(low, -margin), o);
    let to_high = wide_difference(exact_sum(high, margin), o);
    if d == 0.0 {
        let misses = to_low.high > 0.0 || to_high.high < 0.0;
        return Interval(select(-FAR, FAR, misses), select(FAR, -FAR, misses));
    }
    let first = wide_quotient(to_low, Wide(d, 0.0));
    let second = wide_quotient(to_high, Wide(d, 0.0));
    return Interval(min(first, second), max(first, second));
}

// Advance an origin that is far outside; a second step corrects the rounding of the first.
fn advanced(eye: Eye, d: vec3f) -> Eye {
    let outside = max(
        max(
            outside_by(eye.x.high, shading.low.x, shading.high.x),
            outside_by(eye.y.high, shading.low.y, shading.high.y),
        ),
        outside_by(eye.z.high, shading.low.z, shading.high.z),
    );
    if !(outside > FAR_OUTSIDE * params.max_coordinate) {
        return eye;
    }
    var at = eye;
    for (var i = 0; i < 2; i++) {
        let x = wide_crossing(at.x, d.x, shading.low.x, shading.high.x);
        let y = wide_crossing(at.y, d.y, shading.low.y, shading.high.y);
        let z = wide_crossing(at.z, d.z, shading.low.z, shading.high.z);
        let t_in = max(max(x.t_in, y.t_in), z.t_in);
        if !(t_in <= min(min(x.t_out, y.t_out), z.t_out)) {
            at.is_active = false;
            return at;
        }
        at.x = wide_sum(at.x, exact_product(t_in, d.x));
        at.y = wide_sum(at.y, exact_product(t_in, d.y));
        at.z = wide_sum(at.z, exact_product(t_in, d.z));
    }
    return at;
}

// Move a ray of a pinhole camera to a point of the lens, through its point in focus.
fn through_lens(eye: Eye, toward: WideVector, numbers: vec2f) -> array<WideVector, 2> {
    let view = shading.view;
    let place = disk(numbers);
    let across = exact_product(place.x, shading.radius);
    let up = exact_product(place.y, shading.radius);
    let x = wide_sum(
        wide_product(Wide(view.right.x, view.right_low.x), across),
        wide_product(Wide(view.up.x, view.up_low.x), up),
    );
    let y = wide_sum(
        wide_product(Wide(view.right.y, view.right_low.y), across),
        wide_product(Wide(view.up.y, view.up_low.y), up),
    );
    let z = wide_sum(
        wide_product(Wide(view.right.z, view.right_low.z), across),
        wide_product(Wide(view.up.z, view.up_low.z), up),
    );
    let origin = WideVector(wide_sum(eye.x, x), wide_sum(eye.y, y), wide_sum(eye.z, z));
    let direction = WideVector(
        wide_difference(times(shading.focus, toward.x), x),
        wide_difference(times(shading.focus, toward.y), y),
        wide_difference(times(shading.focus, toward.z), z),
    );
    return array<WideVector, 2>(origin, direction);
}

// A ray in the local frame, the largest component of its direction in [1, 2); an empty interval if it
// does not reach the scene.
struct EyeRay {
    origin: vec3f,
    t_min: f32,
    direction: vec3f,
    t_max: f32,
}

// The eye ray of a pixel of the band.
fn eye_ray(number: u32) -> EyeRay {
    let view = shading.view;
    let pixel = shading.first_pixel + number;
    let width = u32(view.width);
    var within = vec2f(0.5);
    if SPREADS {
        within = draw_pair(pixel, shading.sample, 0u);
    }
    let across = exact_sum(f32(pixel % width) - 0.5 * view.width, within.x);
    let down = exact_sum(f32(pixel / width) - 0.5 * view.height, within.y);
    var toward = eye_vector(view, across, down);
    let low = shading.eye_low;
    var eye = Eye(Wide(view.eye.x, low.x), Wide(view.eye.y, low.y), Wide(view.eye.z, low.z), true);
    if SPREADS && shading.radius > 0.0 {
        let moved = through_lens(eye, toward, draw_pair(pixel, shading.sample, 2u));
        eye = Eye(moved[0].x, moved[0].y, moved[0].z, true);
        toward = moved[1];
    }
    var direction = wide_unit(toward);
    direction *= power_for(direction);
    eye = advanced(eye, direction);
    return EyeRay(
        vec3f(eye.x.high, eye.y.high, eye.z.high),
        select(1.0, 0.0, eye.is_active),
        direction,
        select(0.0, FAR, eye.is_active),
    );
}
