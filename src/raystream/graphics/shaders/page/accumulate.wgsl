// Adds the light of a sample to the sums of all samples so far; see rendering/compute.wgsl.

struct Sample {
    pixel_count: u32,
    row_size: u32,
    // The sample, from 0.
    number: u32,
}

@group(0) @binding(0) var<uniform> sample: Sample;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> sums: array<vec4f>;

const LIGHT: u32 = 5u;

@compute @workgroup_size(64)
fn accumulate(@builtin(global_invocation_id) id: vec3u) {
    let i = id.y * sample.row_size + id.x;
    if i >= sample.pixel_count {
        return;
    }
    let light = vec4f(records[LIGHT * sample.pixel_count + i].rgb, 1.0);
    if sample.number == 0u {
        sums[i] = light;
    } else {
        sums[i] += light;
    }
}
