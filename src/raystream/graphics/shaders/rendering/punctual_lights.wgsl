// Direct light at a point. As raystream/rendering/shading/punctual_lights.py.

//! include "rendering/arrival.wgsl"

// Kinds of lights, and columns of a light.
const POINT: u32 = 0u;
const STEADY: u32 = 1u;
const SUN: u32 = 2u;
const PATCH: u32 = 3u;
// What is left of the position in float32.
const PLACE_LOW: u32 = 12u;
const COLUMNS: u32 = 15u;

fn light_number(number: u32, column: u32) -> f32 {
    return lights[COLUMNS * number + column];
}

fn light_vector(number: u32, column: u32) -> vec3f {
    let at = COLUMNS * number + column;
    return vec3f(lights[at], lights[at + 1u], lights[at + 2u]);
}

// The light of one source at a point, without shadows.
fn arriving(number: u32, point: Point) -> Arrival {
    let kind = u32(light_number(number, 6u));
    let high = light_vector(number, 0u);
    let color = light_vector(number, 3u);
    if kind == SUN {
        return Arrival(high, ORIGIN, true, color, true);
    }
    let low = light_vector(number, PLACE_LOW);
    let place = WideVector(Wide(high.x, low.x), Wide(high.y, low.y), Wide(high.z, low.z));
    let way = way_to(WideVector(point.x, point.y, point.z), place);
    let distance = sqrt(dot(way, way));
    if !(distance > 0.0) {
        return NO_LIGHT;
    }
    let toward = way / distance;
    if kind == POINT {
        return Arrival(toward, place, false, color / (distance * distance), true);
    }
    if kind == STEADY {
        return Arrival(toward, place, false, color, true);
    }
    return from_area(number, kind, place, color, toward, distance);
}

// An area light as a point: as a disc seen from its axis; a sphere shows a quarter of its area.
fn from_area(
    number: u32,
    kind: u32,
    place: WideVector,
    color: vec3f,
    toward: vec3f,
    distance: f32,
) -> Arrival {
    let radius = light_number(number, 10u);
    let clearance = light_number(number, 11u);
    let ratio = distance / radius;
    let factor = 1.0 / (ratio * ratio + 1.0);
    let reach = largest(abs(light_vector(number, 0u))) + radius + clearance;
    let away = clearance + offset_at(4.0 * (radius + clearance), reach) + 2.0 * UNIT * distance;
    if kind == PATCH {
        let normal = light_vector(number, 7u);
        let cosine = -dot(toward, normal);
        if cosine <= 0.0 {
            return NO_LIGHT;
        }
        return Arrival(toward, moved(place, normal, away), false, color * (factor * cosine), true);
    }
    let near = moved(place, toward, -min(away, 0.999 * distance));
    return Arrival(toward, near, false, color * (factor * 0.25), true);
}
