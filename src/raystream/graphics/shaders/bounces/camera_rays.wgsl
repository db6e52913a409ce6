// The ray generator: a camera ray through each pixel's centre (Christen 2005, section 5.4.1).

//! include "bounces/params.wgsl"
//! include "bounces/ray_record.wgsl"

@fragment
fn camera_rays(@builtin(position) pixel: vec4f) -> RayRecord {
    return record_of(params.view.eye, eye_direction(params.view, pixel.xy), FAR);
}
