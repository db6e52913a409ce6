// Rays of compute shaders. In scenes with instances, instances/ray_buffer.wgsl replaces this file.

// Origin and t_min, then direction and t_max, of each ray.
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;

fn load_ray(i: u32) -> Ray {
    let from_ = rays[2u * i];
    let to = rays[2u * i + 1u];
    return set_up_ray(from_.xyz, to.xyz, from_.w, to.w);
}
