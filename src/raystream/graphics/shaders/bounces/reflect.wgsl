// The reflected ray, unless its weight is too small (Christen 2005, section 5.2.1).

//! include "bounces/params.wgsl"
//! include "bounces/bsdf.wgsl"
//! include "bounces/hit_record.wgsl"

@group(0) @binding(3) var weights: texture_2d<f32>;

@fragment
fn reflect(@builtin(position) pixel: vec4f) -> RayRecord {
    let place = vec2i(pixel.xy);
    if !any(textureLoad(weights, place, 0).rgb != vec3f(0.0)) {
        return NO_RAY;
    }
    let hit = hit_at(place);
    let toward = mirrored(-hit.direction, hit.point.normal);
    return record_of(spawned(hit.point, toward), toward, FAR);
}
