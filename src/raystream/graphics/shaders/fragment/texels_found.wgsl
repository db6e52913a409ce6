// The first half of texels.wgsl.

struct Texels {
    @location(0) state: vec4u,
    @location(1) found: vec4f,
}

fn texels_of(state: vec4u, found: vec4f, place: vec4u, span: vec4f) -> Texels {
    return Texels(state, found);
}
