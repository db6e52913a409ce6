// Add the light of one source to a surface's colour, unless it is in shadow.

//! include "bounces/params.wgsl"
//! include "bounces/lights.wgsl"
//! include "bounces/hit_record.wgsl"

@group(0) @binding(3) var blocked: texture_2d<u32>;
@group(0) @binding(4) var before: texture_2d<f32>;

@fragment
fn add_light(@builtin(position) pixel: vec4f) -> @location(0) vec4f {
    let place = vec2i(pixel.xy);
    let sum = textureLoad(before, place, 0);
    let hit = hit_at(place);
    if !hit.is_hit || textureLoad(blocked, place, 0).w != 0u {
        return sum;
    }
    let light = arriving(hit.point);
    let color = reflected(lobes_at(hit.point), hit.point, -hit.direction, light.toward);
    return sum + vec4f(color * light.color, 0.0);
}
