// Adds the light of a sample of some pixels to the sums of all samples so far; see
// rendering/compute.wgsl.

struct Band {
    pixel_count: u32,
    row_size: u32,
    // The sample, from 0.
    sample: u32,
    first_pixel: u32,
}

@group(0) @binding(0) var<uniform> band: Band;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> sums: array<vec4f>;

const LIGHT: u32 = 5u;

@compute @workgroup_size(64)
fn accumulate(@builtin(global_invocation_id) id: vec3u) {
    let i = id.y * band.row_size + id.x;
    if i >= band.pixel_count {
        return;
    }
    let light = vec4f(records[LIGHT * band.pixel_count + i].rgb, 1.0);
    let pixel = band.first_pixel + i;
    if band.sample == 0u {
        sums[pixel] = light;
    } else {
        sums[pixel] += light;
    }
}
