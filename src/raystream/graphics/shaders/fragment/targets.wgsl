// What a kernel writes: a texel of each stream, 64 bytes. Where an adapter allows 32, which all do,
// targets_found.wgsl and targets_place.wgsl take this file's place, one after the other.

struct Targets {
    // What the ray waits for, how many hits it has, the triangle of the nearest one, and its budget.
    @location(0) state: vec4u,
    // t, u and v of the nearest hit, and the distance beyond which none is wanted.
    @location(1) found: vec4f,
    // Where its search is, in whole numbers, and in distances: each structure has its own.
    @location(2) place: vec4u,
    @location(3) span: vec4f,
}

fn targets_of(state: vec4u, found: vec4f, place: vec4u, span: vec4f) -> Targets {
    return Targets(state, found, place, span);
}
