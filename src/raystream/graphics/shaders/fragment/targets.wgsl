// Render targets of a kernel: a texel of each stream, 64 bytes. Where an adapter allows only 32,
// the guaranteed minimum, targets_found.wgsl and targets_place.wgsl replace this file in turn.

struct Targets {
    // State of the ray, number of hits, prim_id of the nearest one, and budget.
    @location(0) state: vec4u,
    // t, u and v of the nearest hit, and t_far.
    @location(1) found: vec4f,
    // Traversal state, in integers and in floats, as each structure defines.
    @location(2) place: vec4u,
    @location(3) span: vec4f,
}

fn targets_of(state: vec4u, found: vec4f, place: vec4u, span: vec4f) -> Targets {
    return Targets(state, found, place, span);
}
