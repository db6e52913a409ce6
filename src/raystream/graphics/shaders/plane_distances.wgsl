// Distances to split planes, which depend on the plane's position alone, so that all comparisons
// with a distance t agree. As raystream/structures/kdtree/traversal.py.

// The coefficients of a ray's distances to planes.
struct PlaneRay {
    inv: vec3f,
    // The slab constant without padding.
    middle: vec3f,
}

const SMALLEST: f32 = 0x1p-126;

fn plane_ray(ray: Ray) -> PlaneRay {
    return PlaneRay(ray.inv, (ray.near + ray.far) * 0.5);
}

fn distance_to(line: PlaneRay, axis: u32, position: f32) -> f32 {
    return fused(position, line.inv[axis], line.middle[axis]);
}

// Distances to three planes, one for each axis; `beyond` for those that are at infinity.
fn distances_to(line: PlaneRay, positions: vec3f, beyond: f32) -> vec3f {
    let t = fused3(positions, line.inv, line.middle);
    return select(t, vec3f(beyond), abs(positions) >= vec3f(FAR));
}

// The next float after x, FAR for FAR; denormals are skipped, since not all GPUs have them.
fn just_after(x: f32) -> f32 {
    if abs(x) < SMALLEST {
        return SMALLEST;
    }
    if x >= FAR {
        return FAR;
    }
    let bits = bitcast<u32>(x);
    return bitcast<f32>(select(bits + 1u, bits - 1u, x < 0.0));
}

// The part of a ray in the scene's box, t_in <= t < t_out: it holds every hit, since a hit lies in
// its triangle's interval.
fn searched_part(ray: Ray, low: vec3f, high: vec3f) -> Interval {
    let part = box_interval(ray, low, high);
    return Interval(max(part.t_in, ray.t_min), just_after(min(part.t_out, ray.t_max)));
}
