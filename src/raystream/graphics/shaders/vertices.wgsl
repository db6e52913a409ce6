// Triangles of the scene by prim_id.

fn corner_of(prim_id: u32, corner: u32) -> vec3f {
    let at = 9u * prim_id + 3u * corner;
    return vec3f(corners[at], corners[at + 1u], corners[at + 2u]);
}

fn triangle_of(prim_id: u32) -> Triangle {
    return Triangle(corner_of(prim_id, 0u), corner_of(prim_id, 1u), corner_of(prim_id, 2u));
}
