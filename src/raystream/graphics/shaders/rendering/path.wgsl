// Path tracing: emission, a sample of the lights, and the next direction. As
// raystream/rendering/shading/paths.py.

//! include "rendering/shade.wgsl"
//! include "rendering/sampler.wgsl"
//! include "rendering/scatter.wgsl"
//! include "rendering/light_samples.wgsl"

// Constants of the pipeline: whether lights are sampled; the bounce at which Russian roulette
// starts; whether the last surface that scatters light sends a ray on.
override SAMPLES_LIGHTS: bool = false;
override ROULETTE_BOUNCE: u32 = 3u;
override FOLLOWS_LAST: bool = true;

// Numbers that a path draws at each surface, and those before the first one.
const DIMENSIONS: u32 = 8u;
const FIRST_DIMENSION: u32 = 4u;

const MOST_CHANCE: f32 = 0.95;

fn point_of(path: Path) -> Point {
    return surface_point(u32(path.prim_id), path.u, path.v, path.direction);
}

// Weight of one sampling strategy against another: the power heuristic.
fn mis_weight(pdf: f32, other: f32) -> f32 {
    if other == 0.0 || pdf == FAR {
        return 1.0;
    }
    let ratio = other / pdf;
    return 1.0 / (1.0 + ratio * ratio);
}

// Light with its hue, and no channel above a bound; not that of the first surfaces.
fn clamped(light: vec3f, is_indirect: bool) -> vec3f {
    let brightest = largest(light);
    if is_indirect && brightest > shading.clamp {
        return light * (shading.clamp / brightest);
    }
    return light;
}

fn shade_hit(t: f32) -> bool {
    let is_indirect = pixel.bounce > 1u;
    if current.prim_id == MISS {
        var share = 1.0;
        if SAMPLES_LIGHTS {
            share = mis_weight(current.pdf, sky_pdf());
        }
        gathered += clamped(current.weight * shading.background * share, is_indirect);
        return false;
    }
    let point = point_of(current);
    let distance = t * length(current.direction);
    if !point.is_front {
        current.weight *= transmittance(point, distance);
    } else {
        var light = current.weight * emitted(point);
        if SAMPLES_LIGHTS && current.pdf != FAR {
            let cosine = -dot(normalize(current.direction), point.plane);
            light *= mis_weight(current.pdf, triangle_pdf(point, distance, cosine));
        }
        gathered += clamped(light, is_indirect);
    }
    return pixel.bounce < LAST_BOUNCE;
}

// The number of a pixel in the image.
fn pixel_key() -> u32 {
    return shading.first_pixel + number;
}

// The ray to a sample of the lights.
fn shadow_of(path: Path, _k: u32) -> Spawned {
    let point = point_of(path);
    let lobes = lobes_at(point);
    let back = -normalize(path.direction);
    let dimension = FIRST_DIMENSION + DIMENSIONS * pixel.bounce;
    let numbers = draw_pair(pixel_key(), shading.sample, dimension);
    let choice = draw_number(pixel_key(), shading.sample, dimension + 2u);
    let found = sample_light(point, choice, numbers);
    let color = reflected(lobes, point, back, found.arrival.toward);
    if !found.arrival.is_valid || !(color.x + color.y + color.z > 0.0) {
        return NO_RAY;
    }
    var share = 1.0;
    let is_last = !FOLLOWS_LAST && pixel.bounce + 1u >= LAST_BOUNCE;
    if !is_last && found.pdf != FAR {
        let other = reflection_pdf(lobes, point, back, found.arrival.toward);
        share = mis_weight(found.pdf, other);
    }
    let light = clamped(path.weight * color * found.arrival.color * share, pixel.bounce > 0u);
    return ray_to(point, found.arrival, light);
}

// The scattered ray. The path is of the bounce before.
fn onward_of(path: Path, _branch: u32) -> Spawned {
    let bounce = pixel.bounce - 1u;
    if !FOLLOWS_LAST && bounce + 1u >= LAST_BOUNCE {
        return NO_RAY;
    }
    let point = point_of(path);
    let dimension = FIRST_DIMENSION + DIMENSIONS * bounce;
    let numbers = draw_pair(pixel_key(), shading.sample, dimension + 4u);
    let choice = draw_number(pixel_key(), shading.sample, dimension + 6u);
    let ray = scatter(lobes_at(point), point, -normalize(path.direction), choice, numbers);
    var weight = path.weight * ray.weight;
    let brightest = largest(weight);
    if !ray.is_valid || !(brightest > 0.0) {
        return NO_RAY;
    }
    if bounce >= ROULETTE_BOUNCE {
        let chance = min(brightest, MOST_CHANCE);
        if !(draw_number(pixel_key(), shading.sample, dimension + 7u) < chance) {
            return NO_RAY;
        }
        weight /= chance;
    }
    return Spawned(true, spawned(point, ray.direction), ray.direction, FAR, weight, ray.pdf);
}
