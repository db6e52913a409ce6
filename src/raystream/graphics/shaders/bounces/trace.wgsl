// Traverser and intersector in one program, for hardware with branches (Christen 2005, sections
// 5.4.3 and 5.4.4; Purcell 2002, section 2.2).

//! include "params.wgsl"

@group(0) @binding(1) var origins: texture_2d<f32>;
@group(0) @binding(2) var directions: texture_2d<f32>;
// Number of rays whose budget was spent, and of rays whose loops a driver ended early.
@group(0) @binding(3) var<storage, read_write> failures: array<atomic<u32>>;

//! include "exact.wgsl"
//! include "camera.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "search_state.wgsl"
//! include "no_hit_rows.wgsl"
//! include "tally.wgsl"
//! include "loop_limit.wgsl"

// A first hit: t in lengths of the local direction, weights, and prim_id. For an any-hit query, the
// last word is whether there is a hit.
@fragment
fn trace(@builtin(position) pixel: vec4f) -> @location(0) vec4u {
    let place = vec2i(pixel.xy);
    let origin = textureLoad(origins, place, 0);
    let direction = textureLoad(directions, place, 0);
    begin_search_state(FAR, 0u, 1u);
    if direction.w >= 0.0 {
        let power = power_for(direction.xyz);
        let t_max = select(direction.w / power, FAR, direction.w >= 0x1p+60);
        let ray = set_up_ray(origin.xyz, direction.xyz * power, 0.0, t_max);
        found.t_far = t_max;
        search(ray);
        if found.budget == 0u {
            atomicAdd(&failures[0], 1u);
        }
        if !loops_run() {
            atomicAdd(&failures[1], 1u);
        }
    }
    if QUERY == ANY_HIT {
        return vec4u(0u, 0u, 0u, found.count);
    }
    let hit = vec3u(bitcast<u32>(found.t), bitcast<u32>(found.u), bitcast<u32>(found.v));
    return vec4u(hit, bitcast<u32>(found.prim_id));
}
