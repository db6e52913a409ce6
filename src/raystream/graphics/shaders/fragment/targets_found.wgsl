// The first half of targets.wgsl.

struct Targets {
    @location(0) state: vec4u,
    @location(1) found: vec4f,
}

fn targets_of(state: vec4u, found: vec4f, place: vec4u, span: vec4f) -> Targets {
    return Targets(state, found);
}
