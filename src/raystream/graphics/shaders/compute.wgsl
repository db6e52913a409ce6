// Each invocation traces one ray: all queries, around a structure's search().

//! include "params.wgsl"

// For MULTI_HIT: first row and capacity of each ray.
@group(0) @binding(2) var<storage, read> wanted: array<vec2u>;
@group(0) @binding(3) var<storage, read_write> rows: array<Row>;
// Termination codes; 0 for rays that were not traced.
@group(0) @binding(4) var<storage, read_write> endings: array<u32>;
@group(0) @binding(5) var<storage, read_write> tallies: array<Tally>;

// Whether steps and tests are counted.
override COUNTS: bool = false;

//! include "ray_buffer.wgsl"
//! include "exact.wgsl"
//! include "ray.wgsl"
//! include "triangle.wgsl"
//! include "search_state.wgsl"
//! include "nearest_hits.wgsl"
//! include "tally.wgsl"
//! include "termination.wgsl"

// First row and capacity of a ray.
fn wish_of(i: u32) -> vec2u {
    if QUERY == MULTI_HIT {
        return wanted[i];
    }
    return vec2u(i, params.capacity);
}

@compute @workgroup_size(64)
fn trace(@builtin(global_invocation_id) id: vec3u) {
    let i = id.y * params.row_size + id.x;
    if i >= params.ray_count {
        return;
    }
    let ray = load_ray(i);
    let wish = wish_of(i);
    begin_search_state(ray.t_max, wish.x, wish.y);
    if ray.t_min <= ray.t_max && wish.y != 0u {
        search(ray);
    }
    if QUERY == FIRST_HIT {
        rows[found.first] = Row(found.t, found.u, found.v, found.prim_id);
    } else if QUERY == MULTI_HIT {
        sort_rows();
    }
    if COUNTS {
        note_shadings();
        tallies[i] = tally;
    }
    endings[i] = termination_code();
}
