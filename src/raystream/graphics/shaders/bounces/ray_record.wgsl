// A pixel's ray between passes: two records of four floats.

//! include "ray.wgsl"

struct RayRecord {
    // Local frame; the fourth number is unused.
    @location(0) origin: vec4f,
    // World space, of any length. Then t_max, in its lengths; negative without a ray.
    @location(1) direction: vec4f,
}

const NO_RAY = RayRecord(vec4f(0.0), vec4f(0.0, 0.0, 1.0, -1.0));

fn record_of(origin: vec3f, direction: vec3f, t_max: f32) -> RayRecord {
    return RayRecord(vec4f(origin, 0.0), vec4f(direction, t_max));
}
