// Renders by compute shaders: each dispatch traces the next ray of every pixel from start to end,
// and shades its hit. A mode's file is rendering/shade.wgsl's.

//! include "params.wgsl"
//! include "triangle.wgsl"
//! include "search_state.wgsl"
//! include "no_hit_rows.wgsl"
//! include "tally.wgsl"
//! include "termination.wgsl"
//! include "rendering/eye_rays.wgsl"
//! include "rendering/shade.wgsl"
//! include "multipass/states.wgsl"

// Of each pixel: origin and t_min, direction and t_max of its ray, then its record; those of all
// pixels one after another.
@group(0) @binding(1) var<storage, read_write> records: array<vec4u>;
// Pixels that have a ray, and those that wait for more room; searches that were endless, and those
// that a driver cut short.
@group(0) @binding(2) var<storage, read_write> counts: array<atomic<u32>, 4>;

// The state of a pixel is in the free bits of its record's first word.
const STATE_BITS: u32 = 24u;

fn word_at(word: u32, own: u32) -> u32 {
    return word * params.ray_count + own;
}

fn load_record(own: u32) -> PixelRecord {
    return PixelRecord(
        records[word_at(2u, own)],
        records[word_at(3u, own)],
        records[word_at(4u, own)],
        bitcast<vec4f>(records[word_at(5u, own)]),
    );
}

fn store_record(own: u32, state: u32) {
    var record = pixel_record();
    record.pixel.x |= state << STATE_BITS;
    records[word_at(2u, own)] = record.pixel;
    records[word_at(3u, own)] = record.weight;
    records[word_at(4u, own)] = record.path;
    records[word_at(5u, own)] = bitcast<vec4u>(record.light);
}

fn store_ray(own: u32, origin: vec4f, direction: vec4f) {
    records[word_at(0u, own)] = bitcast<vec4u>(origin);
    records[word_at(1u, own)] = bitcast<vec4u>(direction);
}

// Give each pixel its eye ray.
@compute @workgroup_size(64)
fn begin(@builtin(global_invocation_id) id: vec3u) {
    let own = id.y * params.row_size + id.x;
    if own >= params.ray_count {
        return;
    }
    let ray = eye_ray(own);
    begin_pixel(own);
    store_ray(own, vec4f(ray.origin, ray.t_min), vec4f(ray.direction, ray.t_max));
    store_record(own, STARTING);
}

// Trace the ray of each pixel that has one, and give it the next.
@compute @workgroup_size(64)
fn trace_and_shade(@builtin(global_invocation_id) id: vec3u) {
    let own = id.y * params.row_size + id.x;
    if own >= params.ray_count {
        return;
    }
    let record = load_record(own);
    if record.pixel.x >> STATE_BITS == DONE {
        return;
    }
    read_pixel(own, record);
    if !has_room() {
        atomicAdd(&counts[1], 1u);
        return;
    }
    let origin = bitcast<vec4f>(records[word_at(0u, own)]);
    let direction = bitcast<vec4f>(records[word_at(1u, own)]);
    let ray = set_up_ray(origin.xyz, direction.xyz, origin.w, direction.w);
    begin_search_state(ray.t_max, 0u, 1u);
    if ray.t_min <= ray.t_max {
        search(ray);
    }
    let code = termination_code();
    if code == ENDLESS || code == CUT_SHORT {
        atomicAdd(&counts[select(3u, 2u, code == ENDLESS)], 1u);
    }
    shade_ray(direction.xyz, found.prim_id, vec3f(found.t, found.u, found.v));
    let next = next_ray();
    if next.is_active {
        atomicAdd(&counts[0], 1u);
        store_ray(own, vec4f(next.origin, 0.0), search_direction(next));
        store_record(own, STARTING);
    } else {
        store_record(own, DONE);
    }
}
