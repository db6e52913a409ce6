// Light without shadow rays: emission, ambient light, and the background.

//! include "bounces/params.wgsl"
//! include "bounces/bsdf.wgsl"
//! include "bounces/hit_record.wgsl"

@fragment
fn emission(@builtin(position) pixel: vec4f) -> @location(0) vec4f {
    let hit = hit_at(vec2i(pixel.xy));
    if !hit.is_ray {
        return vec4f(0.0);
    }
    if !hit.is_hit {
        return vec4f(params.background, 0.0);
    }
    let ambient = lobes_at(hit.point).diffuse * params.ambient;
    return vec4f(ambient + select(vec3f(0.0), emitted(hit.point), hit.point.is_front), 0.0);
}
