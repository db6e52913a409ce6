// Searches for the nearest hit of one ray, and records what it visits.

//! include "params.wgsl"
//! include "ray_buffer.wgsl"
//! include "exact.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "search_state.wgsl"
//! include "no_hit_rows.wgsl"
//! include "tally.wgsl"
//! include "termination.wgsl"
//! include "page/record_visits.wgsl"

// Visits, and the termination code.
@group(0) @binding(3) var<storage, read_write> ending: array<u32, 2>;

@compute @workgroup_size(1)
fn walk() {
    let ray = load_ray(0u);
    begin_search_state(ray.t_max, 0u, 1u);
    if ray.t_min <= ray.t_max {
        search(ray);
    }
    visited(END, 0u);
    ending[0] = visit_count;
    ending[1] = termination_code();
}
