// Bitmaps, looked up bilinearly and decoded from sRGB. As raystream/rendering/shading/textures.py.

// For each material: first texel, width, height, bits of what applies, and the six numbers of its
// transform; all zero without a texture. Then the texels: sRGB and an unused byte.
@group(1) @binding(6) var<storage, read> texels: array<u32>;

// Words of a material; bits of what applies, along u and v.
const TEXTURE_WORDS = 10u;
const CLAMPED = vec2u(1u, 4u);
const MIRRORED = vec2u(8u, 16u);
const TRANSFORMED = 2u;

// The texel at an index of -1 to `size`.
fn wrapped(index: i32, size: i32, is_clamped: bool) -> i32 {
    if is_clamped {
        return clamp(index, 0, size - 1);
    }
    return select(select(index, 0, index >= size), size - 1, index < 0);
}

fn linear_of(share: f32) -> f32 {
    return select(pow((share + 0.055) / 1.055, 2.4), share / 12.92, share <= 0.04045);
}

fn bitmap_texel(first: u32, width: i32, column: i32, row: i32) -> vec3f {
    let color = unpack4x8unorm(texels[first + u32(row * width + column)]);
    return vec3f(linear_of(color.x), linear_of(color.y), linear_of(color.z));
}

// Coordinates in a texture with a transform; 0 where they overflow.
fn transformed(first: u32, texcoord: vec2f) -> vec2f {
    let a = bitcast<f32>(texels[first]);
    let b = bitcast<f32>(texels[first + 1u]);
    let c = bitcast<f32>(texels[first + 2u]);
    let d = bitcast<f32>(texels[first + 3u]);
    let e = bitcast<f32>(texels[first + 4u]);
    let f = bitcast<f32>(texels[first + 5u]);
    let place = vec2f(a * texcoord.x + b * texcoord.y + c, d * texcoord.x + e * texcoord.y + f);
    return select(vec2f(0.0), place, max(abs(place.x), abs(place.y)) < UNKNOWN);
}

// Bilinear between texel centres; white without a texture or coordinates; v points up.
fn texture_color(material: u32, texcoord: vec2f) -> vec3f {
    let row = TEXTURE_WORDS * material;
    let first = texels[row];
    let size = vec2i(i32(texels[row + 1u]), i32(texels[row + 2u]));
    let bits = texels[row + 3u];
    if size.x == 0 || max(abs(texcoord.x), abs(texcoord.y)) >= 0.01 * UNKNOWN {
        return vec3f(1.0);
    }
    var at = texcoord;
    if (bits & TRANSFORMED) != 0u {
        at = transformed(row + 4u, at);
    }
    // A mirrored image is folded into [0, 1], and then clamped: beyond its first and its last
    // texel, it has the same texels again.
    let folded = at - 2.0 * floor(0.5 * at);
    at = select(at, min(folded, 2.0 - folded), (vec2u(bits) & MIRRORED) != vec2u(0u));
    let is_clamped = (vec2u(bits) & CLAMPED) != vec2u(0u);
    at = select(at - floor(at), clamp(at, vec2f(0.0), vec2f(1.0)), is_clamped);
    let place = vec2f(at.x, 1.0 - at.y) * vec2f(size) - 0.5;
    let corner = floor(place);
    let share = place - corner;
    let left = wrapped(i32(corner.x), size.x, is_clamped.x);
    let right = wrapped(i32(corner.x) + 1, size.x, is_clamped.x);
    let top = wrapped(i32(corner.y), size.y, is_clamped.y);
    let bottom = wrapped(i32(corner.y) + 1, size.y, is_clamped.y);
    let upper_left = bitmap_texel(first, size.x, left, top);
    let upper_right = bitmap_texel(first, size.x, right, top);
    let lower_left = bitmap_texel(first, size.x, left, bottom);
    let lower_right = bitmap_texel(first, size.x, right, bottom);
    let upper = mix(upper_left, upper_right, share.x);
    let lower = mix(lower_left, lower_right, share.x);
    return mix(upper, lower, share.y);
}
