// Rows for the paths of a pixel's bounce and of the one before, where glass spawns two paths of
// each. A texel holds one path, so they are in a buffer: for each half and row, those of all pixels.

@group(1) @binding(8) var<storage, read_write> rows: array<vec4u>;

const BRANCHES: u32 = 2u;

fn place_of(half: u32, k: u32) -> u32 {
    return 3u * ((half * shading.room + k) * shading.pixel_count + number);
}

fn row_at(half: u32, k: u32) -> Path {
    let at = place_of(half, k);
    let weight = rows[at];
    let path = rows[at + 1u];
    return Path(
        bitcast<vec3f>(weight.xyz),
        bitcast<i32>(weight.w),
        bitcast<f32>(path.w),
        bitcast<f32>(rows[at + 2u].x),
        bitcast<vec3f>(path.xyz),
        FAR,
    );
}

// Append the current path to those of this bounce.
fn put_row() {
    let at = place_of(pixel.half, pixel.row_count);
    rows[at] = vec4u(bitcast<vec3u>(current.weight), bitcast<u32>(current.prim_id));
    rows[at + 1u] = vec4u(bitcast<vec3u>(current.direction), bitcast<u32>(current.u));
    rows[at + 2u] = vec4u(bitcast<u32>(current.v), 0u, 0u, 0u);
}

// Whether there are rows for the paths that shading the current path may spawn.
fn has_room() -> bool {
    let is_last = pixel.is_shadow || pixel.bounce >= LAST_BOUNCE;
    return is_last || pixel.onward_count + BRANCHES <= shading.room;
}

// Count the paths that the current one spawns.
fn count_onward() {
    for (var branch = 0u; branch < BRANCHES; branch++) {
        pixel.onward_count += u32(onward_of(current, branch).is_active);
    }
}
