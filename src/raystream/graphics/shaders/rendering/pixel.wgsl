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

// A pixel's record in memory.
struct PixelRecord {
    pixel: vec4u,
    weight: vec4u,
    path: vec4u,
    light: vec4f,
}

// Begin with a path from the eye.
fn begin_pixel(own: u32) {
    number = own;
    pixel = Pixel(0u, 0u, false, 0u, 0u, 0u, 0u, 0u, 0u);
    current = Path(vec3f(1.0), MISS, 0.0, 0.0, vec3f(0.0), FAR);
    gathered = vec3f(0.0);
}

fn read_pixel(own: u32, record: PixelRecord) {
    number = own;
    let flags = record.pixel.x;
    let counts = record.pixel.y;
    pixel = Pixel(
        flags & 0xffffu,
        (flags >> 16u) & 1u,
        (flags & 0x20000u) != 0u,
        counts & 0xffu,
        (flags >> 18u) & 1u,
        (counts >> 8u) & 0xffu,
        (counts >> 16u) & 0xffu,
        counts >> 24u,
        record.pixel.z,
    );
    gathered = record.light.rgb;
    current = Path(
        bitcast<vec3f>(record.weight.xyz),
        bitcast<i32>(record.weight.w),
        bitcast<f32>(record.path.w),
        record.light.w,
        bitcast<vec3f>(record.path.xyz),
        bitcast<f32>(record.pixel.w),
    );
}

fn pixel_record() -> PixelRecord {
    let flags = (pixel.half << 16u) | select(0u, 0x20000u, pixel.is_shadow) | (pixel.branch << 18u);
    let counts = pixel.source | (pixel.source_count << 8u) | (pixel.row_count << 16u);
    return PixelRecord(
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
