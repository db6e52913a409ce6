// The second half of targets.wgsl.

struct Targets {
    @location(0) place: vec4u,
    @location(1) span: vec4f,
}

fn targets_of(state: vec4u, found: vec4f, place: vec4u, span: vec4f) -> Targets {
    return Targets(place, span);
}
