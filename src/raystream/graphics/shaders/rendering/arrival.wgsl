// Light that arrives at a point, and the shadow rays to where it comes from.

//! include "rendering/bsdf.wgsl"

// Numbers of lights; their rows depend on the mode.
@group(1) @binding(7) var<storage, read> lights: array<f32>;

struct Arrival {
    // Unit vector to the light.
    toward: vec3f,
    // The end of the shadow ray, local frame, off the light's own surface.
    place: WideVector,
    is_far: bool,
    // Irradiance of a surface that faces the light.
    color: vec3f,
    is_valid: bool,
}

const ORIGIN = WideVector(Wide(0.0, 0.0), Wide(0.0, 0.0), Wide(0.0, 0.0));
const NO_LIGHT = Arrival(vec3f(0.0, 0.0, 1.0), ORIGIN, true, vec3f(0.0), false);

// The vector from one place to another, without cancellation where they are close.
fn way_to(origin: WideVector, place: WideVector) -> vec3f {
    return vec3f(
        wide_difference(place.x, origin.x).high,
        wide_difference(place.y, origin.y).high,
        wide_difference(place.z, origin.z).high,
    );
}

// A place moved along a vector.
fn moved(place: WideVector, along: vec3f, factor: f32) -> WideVector {
    return WideVector(
        wide_sum(place.x, exact_product(factor, along.x)),
        wide_sum(place.y, exact_product(factor, along.y)),
        wide_sum(place.z, exact_product(factor, along.z)),
    );
}

// The shadow ray from a point to a light; `brought` is its light if nothing blocks it.
fn ray_to(point: Point, light: Arrival, brought: vec3f) -> Spawned {
    let origin = wide_origin(point, light.toward);
    let start = vec3f(origin.x.high, origin.y.high, origin.z.high);
    if light.is_far {
        return Spawned(true, start, light.toward, FAR, brought, FAR);
    }
    return Spawned(true, start, way_to(origin, light.place), 1.0, brought, FAR);
}
