// Direct light at a point. As raystream/rendering/shading/punctual_lights.py.

//! include "bounces/bsdf.wgsl"

@group(1) @binding(6) var<storage, read> lights: array<f32>;

// Kinds of lights, and columns of a light.
const POINT: u32 = 0u;
const STEADY: u32 = 1u;
const SUN: u32 = 2u;
const PATCH: u32 = 3u;
const COLUMNS: u32 = 12u;

struct Arrival {
    // Unit vector to the light.
    toward: vec3f,
    // The end of the shadow ray, local frame, off the light's own surface.
    place: vec3f,
    is_far: bool,
    // Irradiance of a surface that faces the light.
    color: vec3f,
}

const NO_LIGHT = Arrival(vec3f(0.0, 0.0, 1.0), vec3f(0.0), true, vec3f(0.0));

fn light_number(column: u32) -> f32 {
    return lights[COLUMNS * params.number + column];
}

fn light_vector(column: u32) -> vec3f {
    return vec3f(light_number(column), light_number(column + 1u), light_number(column + 2u));
}

// The vector from a surface point to a place, without cancellation near it.
fn way_to(point: Point, place: vec3f) -> vec3f {
    return vec3f(
        wide_difference(Wide(place.x, 0.0), point.x).high,
        wide_difference(Wide(place.y, 0.0), point.y).high,
        wide_difference(Wide(place.z, 0.0), point.z).high,
    );
}

// The light of one source at a point, without shadows.
fn arriving(point: Point) -> Arrival {
    let kind = u32(light_number(6u));
    let place = light_vector(0u);
    let color = light_vector(3u);
    if kind == SUN {
        return Arrival(place, vec3f(0.0), true, color);
    }
    let way = way_to(point, place);
    let distance = sqrt(dot(way, way));
    if !(distance > 0.0) {
        return NO_LIGHT;
    }
    let toward = way / distance;
    if kind == POINT {
        return Arrival(toward, place, false, color / (distance * distance));
    }
    if kind == STEADY {
        return Arrival(toward, place, false, color);
    }
    return from_area(kind, place, color, toward, distance);
}

// An area light as a point: as a disc seen from its axis; a sphere shows a quarter of its area.
fn from_area(kind: u32, place: vec3f, color: vec3f, toward: vec3f, distance: f32) -> Arrival {
    let radius = light_number(10u);
    let clearance = light_number(11u);
    let ratio = distance / radius;
    let factor = 1.0 / (ratio * ratio + 1.0);
    let reach = largest(abs(place)) + radius + clearance;
    let away = clearance + offset_at(4.0 * (radius + clearance), reach) + 2.0 * UNIT * distance;
    if kind == PATCH {
        let normal = light_vector(7u);
        let cosine = -dot(toward, normal);
        if cosine <= 0.0 {
            return NO_LIGHT;
        }
        return Arrival(toward, place + away * normal, false, color * (factor * cosine));
    }
    let near = place - min(away, 0.999 * distance) * toward;
    return Arrival(toward, near, false, color * (factor * 0.25));
}
