// Render targets of the kernels that give pixels their rays: 112 bytes.

struct Targets {
    // As in fragment/targets.wgsl.
    @location(0) state: vec4u,
    // Local frame, then t_min.
    @location(1) origin: vec4f,
    // Local frame, the largest component in [1, 2); then t_max.
    @location(2) direction: vec4f,
    // Records of a pixel, which only the renderer reads.
    @location(3) pixel: vec4u,
    @location(4) weight: vec4u,
    @location(5) path: vec4u,
    @location(6) light: vec4f,
}

fn nothing() -> Targets {
    return Targets(vec4u(), vec4f(), vec4f(), vec4u(), vec4u(), vec4u(), vec4f());
}
