// Shows mean counts per pixel in false colours, from 0 to the largest. As
// raystream/rendering/false_colors.py.

//! include "page/picture.wgsl"

// The largest count of a pixel: its bits, in the order of which floats from 0 on are.
@group(0) @binding(2) var<storage, read_write> most: atomic<u32>;
// Colours from 0 to the top of the scale, sRGB bytes.
@group(0) @binding(3) var<storage, read> ramp: array<u32>;

fn count_of(pixel: u32) -> f32 {
    return mean_of(pixel)[picture.channel];
}

@compute @workgroup_size(8, 8)
fn find_most(@builtin(global_invocation_id) id: vec3u) {
    if id.x < picture.width && id.y < picture.height {
        atomicMax(&most, bitcast<u32>(count_of(id.y * picture.width + id.x)));
    }
}

@fragment
fn show_counts(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let top = bitcast<f32>(atomicLoad(&most));
    let level = count_of(pixel_at(position)) / select(1.0, top, top > 0.0);
    let last = arrayLength(&ramp) - 1u;
    return unpack4x8unorm(ramp[min(u32(round(level * f32(last))), last)]);
}
