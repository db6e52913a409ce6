// Samples of the lights. As raystream/rendering/shading/lights.py, with the tables of
// light_tables.py, one after the other: cumulative probabilities of the lights, their
// probabilities, points, suns, cumulative shares of the area lights' triangles, these triangles,
// and the density of samples on them by material.

//! include "rendering/arrival.wgsl"
//! include "rendering/warp.wgsl"

// Numbers in a row of points, of suns, and of triangles.
const POINT_WIDTH: u32 = 10u;
const SUN_WIDTH: u32 = 6u;
const PATCH_WIDTH: u32 = 17u;

const INV_FOUR_PI: f32 = 0.0795774715;
const TINY: f32 = 1e-37;

// Below 1.
const MOST_WITHIN: f32 = 0x1.fffffep-1;

struct LightSample {
    // With irradiance over the probability of the sample.
    arrival: Arrival,
    // Density over solid angle; FAR for lights that no ray hits.
    pdf: f32,
}

const NO_SAMPLE = LightSample(NO_LIGHT, FAR);

fn source_count() -> u32 {
    return shading.point_count + shading.sun_count + 2u;
}

fn points_at() -> u32 {
    return 2u * source_count();
}

fn suns_at() -> u32 {
    return points_at() + POINT_WIDTH * shading.point_count;
}

fn triangle_ends_at() -> u32 {
    return suns_at() + SUN_WIDTH * shading.sun_count;
}

fn patches_at() -> u32 {
    return triangle_ends_at() + shading.patch_count;
}

fn floats_at(at: u32) -> vec3f {
    return vec3f(lights[at], lights[at + 1u], lights[at + 2u]);
}

// The index whose interval of cumulative probabilities has a number.
fn sample_discrete(first: u32, count: u32, number: f32) -> u32 {
    var low = 0u;
    var high = count;
    while high - low > 1u {
        let middle = (low + high) >> 1u;
        if lights[first + middle - 1u] <= number {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

fn sample_point(number: u32, share: f32, point: Point) -> LightSample {
    let row = points_at() + POINT_WIDTH * number;
    let high = floats_at(row);
    let low = floats_at(row + 7u);
    let place = WideVector(Wide(high.x, low.x), Wide(high.y, low.y), Wide(high.z, low.z));
    let way = way_to(WideVector(point.x, point.y, point.z), place);
    let distance = sqrt(dot(way, way));
    if !(distance > 0.0) {
        return NO_SAMPLE;
    }
    let square = select(1.0, distance * distance, lights[row + 6u] != 0.0);
    let color = floats_at(row + 3u) / (share * square);
    return LightSample(Arrival(way / distance, place, false, color, true), FAR);
}

fn sample_triangle(within: f32, numbers: vec2f, point: Point) -> LightSample {
    let number = sample_discrete(triangle_ends_at(), shading.patch_count, within);
    let row = patches_at() + PATCH_WIDTH * number;
    let corner = floats_at(row);
    let normal = floats_at(row + 9u);
    let weights = on_triangle(numbers);
    let along = weights.x * floats_at(row + 3u) + weights.y * floats_at(row + 6u);
    let place = WideVector(
        exact_sum(corner.x, along.x),
        exact_sum(corner.y, along.y),
        exact_sum(corner.z, along.z),
    );
    let way = way_to(WideVector(point.x, point.y, point.z), place);
    let distance = sqrt(dot(way, way));
    if !(distance > 0.0) {
        return NO_SAMPLE;
    }
    let toward = way / distance;
    let cosine = -dot(toward, normal);
    let pdf = lights[row + 15u] * distance * distance / max(cosine, TINY);
    if !(cosine > 0.0 && pdf > 0.0 && pdf < FAR) {
        return NO_SAMPLE;
    }
    // Off the light's own triangle, so that it does not block its light.
    let reach = largest(abs(vec3f(place.x.high, place.y.high, place.z.high)));
    let away = offset_at(2.0 * lights[row + 16u], reach) + 2.0 * UNIT * distance;
    let color = floats_at(row + 12u) / pdf;
    return LightSample(Arrival(toward, moved(place, normal, away), false, color, true), pdf);
}

// Sample one light. Visibility is not tested.
fn sample_light(point: Point, choice: f32, numbers: vec2f) -> LightSample {
    let number = sample_discrete(0u, source_count(), choice);
    let share = lights[source_count() + number];
    if number < shading.point_count {
        return sample_point(number, share, point);
    }
    let sun = number - shading.point_count;
    if sun < shading.sun_count {
        let row = suns_at() + SUN_WIDTH * sun;
        let color = floats_at(row + 3u) / share;
        return LightSample(Arrival(floats_at(row), ORIGIN, true, color, true), FAR);
    }
    if sun == shading.sun_count {
        let pdf = share * INV_FOUR_PI;
        if !(pdf > 0.0) {
            return NO_SAMPLE;
        }
        let color = shading.background / pdf;
        return LightSample(Arrival(sphere(numbers), ORIGIN, true, color, true), pdf);
    }
    var start = 0.0;
    if number != 0u {
        start = lights[number - 1u];
    }
    return sample_triangle(clamp((choice - start) / share, 0.0, MOST_WITHIN), numbers, point);
}

// Density over solid angle of sample_light() for the sky.
fn sky_pdf() -> f32 {
    return lights[source_count() + shading.point_count + shading.sun_count] * INV_FOUR_PI;
}

// The same for a point on an area light, at a local distance.
fn triangle_pdf(point: Point, distance: f32, cosine: f32) -> f32 {
    let densities = patches_at() + PATCH_WIDTH * shading.patch_count;
    let density = lights[densities + point.material];
    return density * (distance * distance / max(abs(cosine), TINY));
}
