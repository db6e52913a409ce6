// One fragment program traces each ray from start to end, around a structure's search().

//! include "fragment/frame.wgsl"
//! include "termination.wgsl"

@fragment
fn trace(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    let number = ray_number(texel);
    if number >= params.ray_count {
        // Not a discard: one software driver then loses writes to buffers, also of other fragments.
        return targets_of(vec4u(), vec4f(), vec4u(), vec4f());
    }
    let ray = ray_at(texel);
    let wish = textureLoad(wanted, texel, 0);
    begin_search_state(ray.t_max, wish.x, wish.y);
    if ray.t_min <= ray.t_max {
        search(ray);
    }
    if QUERY == MULTI_HIT {
        sort_rows();
    }
    note_shadings();
    add_tallies(number);
    return targets_of(
        vec4u(0u, termination_code(), bitcast<u32>(found.prim_id), found.budget),
        vec4f(found.t, found.u, found.v, found.t_far),
        vec4u(),
        vec4f(),
    );
}
