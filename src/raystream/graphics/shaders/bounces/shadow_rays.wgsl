// The shadow ray from a surface to a light, unless the light has no effect there.

//! include "bounces/params.wgsl"
//! include "bounces/lights.wgsl"
//! include "bounces/hit_record.wgsl"

@fragment
fn shadow_rays(@builtin(position) pixel: vec4f) -> RayRecord {
    let hit = hit_at(vec2i(pixel.xy));
    if !hit.is_hit {
        return NO_RAY;
    }
    let light = arriving(hit.point);
    let color = reflected(lobes_at(hit.point), hit.point, -hit.direction, light.toward);
    if !(largest(color) > 0.0 && any(light.color != vec3f(0.0))) {
        return NO_RAY;
    }
    let origin = spawned(hit.point, light.toward);
    if light.is_far {
        return record_of(origin, light.toward, FAR);
    }
    return record_of(origin, light.place - origin, 1.0);
}
