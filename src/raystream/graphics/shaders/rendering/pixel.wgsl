// A pixel's record between passes: which of its rays is traced, and the path that it belongs to.

//! include "rendering/shading.wgsl"

// A path at a surface.
struct Path {
    // Throughput: the share of its light that reaches the pixel.
    weight: vec3f,
    // The nearest hit of its ray.
    prim_id: i32,
    u: f32,
    v: f32,
    // World space, of any length.
    direction: vec3f,
    // Density with which its direction was chosen; FAR for those that no sample of a light finds.
    pdf: f32,
}

struct Pixel {
    bounce: u32,
    // Which half of its rows has the paths of this bounce.
    half: u32,
    // Whether the ray that is traced is a shadow ray.
    is_shadow: bool,
    // The next ray to spawn from the paths of the bounce before: path, and branch behind glass.
    source: u32,
    branch: u32,
    source_count: u32,
    // Paths of this bounce at surfaces, and the paths that they spawn.
    row_count: u32,
    onward_count: u32,
    // The shadow ray that is traced, or comes next.
    shadow: u32,
}

var<private> number: u32;
var<private> pixel: Pixel;
// The path whose ray is traced.
var<private> current: Path;
// Radiance of the pixel so far.
var<private> gathered: vec3f;

fn load_pixel(texel: vec2i) {
    number = pixel_number(texel);
    let record = textureLoad(pixels, texel, 0);
    let counts = record.y;
    pixel = Pixel(
        record.x & 0xffffu,
        (record.x >> 16u) & 1u,
        (record.x & 0x20000u) != 0u,
        counts & 0xffu,
        (record.x >> 18u) & 1u,
        (counts >> 8u) & 0xffu,
        (counts >> 16u) & 0xffu,
        counts >> 24u,
        record.z,
    );
    let weight = textureLoad(weights, texel, 0);
    let path = textureLoad(paths, texel, 0);
    let light = textureLoad(lights_found, texel, 0);
    gathered = light.rgb;
    current = Path(
        bitcast<vec3f>(weight.xyz),
        bitcast<i32>(weight.w),
        bitcast<f32>(path.w),
        light.w,
        bitcast<vec3f>(path.xyz),
        bitcast<f32>(record.w),
    );
}

fn pixel_targets(state: vec4u, origin: vec4f, direction: vec4f) -> Targets {
    let flags = (pixel.half << 16u) | select(0u, 0x20000u, pixel.is_shadow) | (pixel.branch << 18u);
    let counts = pixel.source | (pixel.source_count << 8u) | (pixel.row_count << 16u);
    return Targets(
        state,
        origin,
        direction,
        vec4u(
            pixel.bounce | flags,
            counts | (pixel.onward_count << 24u),
            pixel.shadow,
            bitcast<u32>(current.pdf),
        ),
        vec4u(bitcast<vec3u>(current.weight), bitcast<u32>(current.prim_id)),
        vec4u(bitcast<vec3u>(current.direction), bitcast<u32>(current.u)),
        vec4f(gathered, current.v),
    );
}
