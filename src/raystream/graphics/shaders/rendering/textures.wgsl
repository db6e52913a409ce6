// Bitmaps, looked up bilinearly and decoded from sRGB. As raystream/rendering/shading/textures.py.

// For each material: first texel, width, height, and 1 if it is clamped; all zero without a
// texture. Then the texels: sRGB and an unused byte.
@group(1) @binding(6) var<storage, read> texels: array<u32>;

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

// Bilinear between texel centres; white without a texture or coordinates; v points up.
fn texture_color(material: u32, texcoord: vec2f) -> vec3f {
    let first = texels[4u * material];
    let size = vec2i(i32(texels[4u * material + 1u]), i32(texels[4u * material + 2u]));
    let is_clamped = texels[4u * material + 3u] != 0u;
    if size.x == 0 || max(abs(texcoord.x), abs(texcoord.y)) >= 0.01 * UNKNOWN {
        return vec3f(1.0);
    }
    let within = select(texcoord - floor(texcoord), clamp(texcoord, vec2f(0.0), vec2f(1.0)), is_clamped);
    let place = vec2f(within.x, 1.0 - within.y) * vec2f(size) - 0.5;
    let corner = floor(place);
    let share = place - corner;
    let left = wrapped(i32(corner.x), size.x, is_clamped);
    let right = wrapped(i32(corner.x) + 1, size.x, is_clamped);
    let top = wrapped(i32(corner.y), size.y, is_clamped);
    let bottom = wrapped(i32(corner.y) + 1, size.y, is_clamped);
    let upper_left = bitmap_texel(first, size.x, left, top);
    let upper_right = bitmap_texel(first, size.x, right, top);
    let lower_left = bitmap_texel(first, size.x, left, bottom);
    let lower_right = bitmap_texel(first, size.x, right, bottom);
    let upper = mix(upper_left, upper_right, share.x);
    let lower = mix(lower_left, lower_right, share.x);
    return mix(upper, lower, share.y);
}
