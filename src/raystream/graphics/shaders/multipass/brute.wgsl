// Brute force as kernels: one triangle per ray and step (Foley 2005, section 4). As
// raystream/machines/steps/brute.py.

//! include "multipass/frame.wgsl"

// Begin with the first triangle.
@fragment
fn set_up(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, STARTING) {
        return nothing();
    }
    run_count = 1u;
    let ray = ray_at(texel);
    found.t_far = ray.t_max;
    let is_active = params.tree.triangle_count != 0u && ray.t_min <= ray.t_max;
    return end_kernel(texel, select(end_state(), INTERSECTING, is_active), vec4u(), vec4f());
}

// Test a triangle.
@fragment
fn intersect_next(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, INTERSECTING) {
        return nothing();
    }
    let ray = ray_at(texel);
    var row = textureLoad(places, texel, 0).x;
    var state = INTERSECTING;
    for (var i = 0u; i < INTERSECTIONS && state == INTERSECTING; i++) {
        if !count_step() {
            state = DONE;
            break;
        }
        test_row(ray, row);
        row += 1u;
        if row == params.tree.triangle_count || is_full() {
            state = end_state();
        }
    }
    return end_kernel(texel, state, vec4u(row, 0u, 0u, 0u), vec4f());
}
