// Shading, the last kernel of all traversals. As raystream/machines/steps/base.py.

// End a ray: its hits are sorted, and counted as shaded.
@fragment
fn shade(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, SHADING) {
        return nothing();
    }
    run_count = 1u;
    tally.shadings = 1u;
    if QUERY == MULTI_HIT {
        if found.capacity != 1u {
            sort_rows();
        }
        tally.shadings = found.count;
    }
    return end_kernel(texel, DONE, vec4u(), vec4f());
}
