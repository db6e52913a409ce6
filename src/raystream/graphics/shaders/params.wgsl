// Uniforms of all rays of a search, and the structure's. As raystream/graphics/structures/base.py.

struct Params {
    // Largest absolute coordinate of the scene.
    max_coordinate: f32,
    // 0: see exact.wgsl.
    zero: u32,
    ray_count: u32,
    // Rays in a row of textures, or of workgroups, whose number per dimension is limited.
    row_size: u32,
    // Steps and tests before a search counts as endless.
    budget: u32,
    // Hits wanted of each ray, where that is the same for all.
    capacity: u32,
    @align(16) tree: Tree,
}

@group(0) @binding(0) var<uniform> params: Params;
