// The second half of texels.wgsl.

struct Texels {
    @location(0) place: vec4u,
    @location(1) span: vec4f,
}

fn texels_of(state: vec4u, found: vec4f, place: vec4u, span: vec4f) -> Texels {
    return Texels(place, span);
}
