// Gives each pixel its eye ray.

//! include "multipass/loop/frame.wgsl"
//! include "multipass/loop/pixel_targets.wgsl"
//! include "rendering/eye_rays.wgsl"
//! include "rendering/pixel.wgsl"

@fragment
fn eye_rays(@builtin(position) position: vec4f) -> Targets {
    let own = pixel_number(texel_at(position));
    if own >= params.ray_count {
        discard;
    }
    let ray = eye_ray(own);
    begin_pixel(own);
    return targets_of(
        vec4u(STARTING, 0u, bitcast<u32>(MISS), params.budget),
        vec4f(ray.origin, ray.t_min),
        vec4f(ray.direction, ray.t_max),
    );
}
