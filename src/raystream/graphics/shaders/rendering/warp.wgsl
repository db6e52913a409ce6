// Warps of the unit square to disks and directions. As raystream/rendering/sampling/warp.py.

const TWO_PI: f32 = 6.28318530717958647692;

const SIN_0: f32 = -1.6666654611e-1;
const SIN_1: f32 = 8.3321608736e-3;
const SIN_2: f32 = -1.9515295891e-4;
const COS_0: f32 = 4.166664568298827e-2;
const COS_1: f32 = -1.388731625493765e-3;
const COS_2: f32 = 2.443315711809948e-5;

// Cosine and sine of an angle whose unit is a full turn: within a quarter of it, polynomials as in
// raystream/jit/simd/elementary.py, since a driver's own may be off by 2^-11.
fn sincos_turns(part: f32) -> vec2f {
    let quadrant = floor(part * 4.0 + 0.5);
    let angle = (part - quadrant * 0.25) * TWO_PI;
    let square = angle * angle;
    let sine = angle + angle * square * (SIN_0 + square * (SIN_1 + square * SIN_2));
    let cosine = (1.0 - 0.5 * square)
        + square * square * (COS_0 + square * (COS_1 + square * COS_2));
    switch u32(i32(quadrant) & 3) {
        case 0u: {
            return vec2f(cosine, sine);
        }
        case 1u: {
            return vec2f(-sine, cosine);
        }
        case 2u: {
            return vec2f(-cosine, -sine);
        }
        default: {
            return vec2f(sine, -cosine);
        }
    }
}

// A uniform point of the unit disk (Shirley and Chiu 1997).
fn disk(numbers: vec2f) -> vec2f {
    let place = 2.0 * numbers - 1.0;
    let is_wide = abs(place.x) > abs(place.y);
    let radius = select(place.y, place.x, is_wide);
    let rest = select(place.x, place.y, is_wide);
    let part = 0.125 * (rest / select(radius, 1.0, radius == 0.0));
    return radius * sincos_turns(select(0.25 - part, part, is_wide));
}

// A direction around +z with density proportional to its cosine.
fn cosine_hemisphere(numbers: vec2f) -> vec3f {
    let place = disk(numbers);
    return vec3f(place, sqrt(max(1.0 - place.x * place.x - place.y * place.y, 0.0)));
}

// A uniform direction.
fn sphere(numbers: vec2f) -> vec3f {
    let radius = 2.0 * sqrt(numbers.x * (1.0 - numbers.x));
    return vec3f(radius * sincos_turns(numbers.y), 1.0 - 2.0 * numbers.x);
}

// 1 - exp(x) for x <= 0, accurate near 0.
fn missing(x: f32) -> f32 {
    if x > -0.25 {
        return -x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0))));
    }
    return 1.0 - exp(x);
}

// A direction around +z with density proportional to a power of its cosine: Phong's lobe.
fn power_cosine(numbers: vec2f, exponent: f32) -> vec3f {
    let height = log(1.0 - numbers.x) / (exponent + 1.0);
    return vec3f(sqrt(missing(2.0 * height)) * sincos_turns(numbers.y), exp(height));
}

// A uniform point of a triangle, as weights of vertices 1 and 2 (Heitz 2019).
fn on_triangle(numbers: vec2f) -> vec2f {
    if numbers.y > numbers.x {
        return vec2f(0.5 * numbers.x, numbers.y - 0.5 * numbers.x);
    }
    return vec2f(numbers.x - 0.5 * numbers.y, 0.5 * numbers.y);
}

// Rotate a direction around +z to one around a unit normal (Duff et al. 2017).
fn around(direction: vec3f, normal: vec3f) -> vec3f {
    let side = with_sign(1.0, normal.z);
    let a = -1.0 / (side + normal.z);
    let b = normal.x * normal.y * a;
    let tangent = vec3f(1.0 + side * normal.x * normal.x * a, side * b, -side * normal.x);
    let bitangent = vec3f(b, side + normal.y * normal.y * a, -normal.y);
    return direction.x * tangent + direction.y * bitangent + direction.z * normal;
}
