// A pixel's hit between passes.

@group(0) @binding(1) var directions: texture_2d<f32>;
@group(0) @binding(2) var hits: texture_2d<u32>;

struct HitRecord {
    // Whether there is a ray, and whether it hit a surface.
    is_ray: bool,
    is_hit: bool,
    // Of unit length.
    direction: vec3f,
    point: Point,
}

fn hit_at(place: vec2i) -> HitRecord {
    var record: HitRecord;
    let ray = textureLoad(directions, place, 0);
    let hit = textureLoad(hits, place, 0);
    record.is_ray = ray.w >= 0.0;
    record.is_hit = record.is_ray && bitcast<i32>(hit.w) >= 0;
    record.direction = normalize(ray.xyz);
    if record.is_hit {
        let u = bitcast<f32>(hit.y);
        let v = bitcast<f32>(hit.z);
        record.point = surface_point(hit.w, u, v, record.direction);
    }
    return record;
}
