// What all rays of a search share, and the structure's own numbers. As raystream/graphics/structures/base.py.

struct Params {
    // Largest absolute coordinate of the scene.
    max_coordinate: f32,
    // 0: see exact.wgsl.
    zero: u32,
    ray_count: u32,
    // Rays in a row of textures, or in a row of workgroups, as one dimension may have too few.
    row_size: u32,
    // Steps and tests before a search counts as endless.
    budget: u32,
    // Hits wanted of each ray, where all want as many.
    capacity: u32,
    @align(16) tree: Tree,
}

@group(0) @binding(0) var<uniform> params: Params;
