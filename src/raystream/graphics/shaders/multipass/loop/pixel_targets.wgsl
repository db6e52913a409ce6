// The targets of a pixel whose record is that of rendering/pixel.wgsl.

fn targets_of(state: vec4u, origin: vec4f, direction: vec4f) -> Targets {
    let own = pixel_record();
    return Targets(state, origin, direction, own.pixel, own.weight, own.path, own.light);
}
