// The iteration buffer: equation 5.1 of Christen 2005, one term at a time.
//
//     c(n) = sum over j of M_j (r_1 ... r_(j-1)) (1 - r_j)
//
// R holds the product: the path's weight. R times the surface's own light M is added to the colour,
// where the diffuse part of M has the factor 1 - r; then R is multiplied by r.

//! include "bounces/params.wgsl"
//! include "bounces/bsdf.wgsl"
//! include "bounces/hit_record.wgsl"

@group(0) @binding(3) var surface_light: texture_2d<f32>;
@group(0) @binding(4) var weights: texture_2d<f32>;
@group(0) @binding(5) var picture: texture_2d<f32>;

struct IterationBuffer {
    @location(0) color: vec4f,
    // R.
    @location(1) weight: vec4f,
}

@fragment
fn accumulate(@builtin(position) pixel: vec4f) -> IterationBuffer {
    let place = vec2i(pixel.xy);
    let weight = textureLoad(weights, place, 0).rgb;
    let light = textureLoad(surface_light, place, 0).rgb;
    let color = textureLoad(picture, place, 0).rgb + weight * light;
    let hit = hit_at(place);
    var onward = vec3f(0.0);
    if hit.is_hit {
        let toward = mirrored(-hit.direction, hit.point.normal);
        onward = weight * lobes_at(hit.point).reflection;
        if !(largest(onward) > params.min_weight && dot(hit.point.plane, toward) > 0.0) {
            onward = vec3f(0.0);
        }
    }
    return IterationBuffer(vec4f(color, 1.0), vec4f(onward, 0.0));
}
