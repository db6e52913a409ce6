// The hit of each pixel's camera ray on the triangle that the rasteriser found.

//! include "raster/params.wgsl"

@group(0) @binding(1) var seen: texture_2d<i32>;
@group(1) @binding(0) var<storage, read> corners: array<f32>;

// Rasterisers snap vertices to a lattice, usually of 1/256 pixel, so a ray may miss the triangle by
// as much. Its hit is then that with the triangle's plane, at the nearest weights.
fn hit_beside(ray: Ray, triangle: Triangle) -> Hit {
    let a = to_frame(ray.kz, triangle.a);
    let b = to_frame(ray.kz, triangle.b);
    let c = to_frame(ray.kz, triangle.c);
    let v_weight = wide_edge(image_of(ray, a), image_of(ray, c));
    let w_weight = wide_edge(image_of(ray, b), image_of(ray, a));
    let u_weight = wide_edge(image_of(ray, c), image_of(ray, b));
    let sum = wide_sum(wide_sum(u_weight, v_weight), w_weight);
    var weights = vec3f(1.0, 0.0, 0.0);
    if sum.high != 0.0 {
        weights = vec3f(
            wide_quotient(u_weight, sum),
            wide_quotient(v_weight, sum),
            wide_quotient(w_weight, sum),
        );
        weights = clamp(weights, vec3f(0.0), vec3f(1.0));
        weights /= weights.x + weights.y + weights.z;
    }
    let place = weights.x * a + weights.y * b + weights.z * c - ray.origin;
    let t = dot(place, ray.direction) / dot(ray.direction, ray.direction);
    return Hit(true, max(t, 0.0), weights.y, weights.z);
}

// Distance in world units, weights of vertices 1 and 2, and prim_id.
@fragment
fn resolve(@builtin(position) pixel: vec4f) -> @location(0) vec4u {
    let prim_id = textureLoad(seen, vec2i(pixel.xy), 0).x;
    if prim_id < 0 {
        return vec4u(bitcast<u32>(FAR), 0u, 0u, bitcast<u32>(prim_id));
    }
    let direction = eye_direction(params.view, pixel.xy);
    let power = power_for(direction);
    let ray = set_up_ray(params.view.eye, direction * power, 0.0, FAR);
    let triangle = triangle_of(u32(prim_id));
    var hit = intersect(ray, triangle);
    if !hit.is_hit {
        hit = hit_beside(ray, triangle);
    }
    let t = hit.t * power * params.view.inverse_scale;
    return vec4u(bitcast<u32>(t), bitcast<u32>(hit.u), bitcast<u32>(hit.v), u32(prim_id));
}
