// Rasterisation: the nearest triangle of each pixel, by the depth buffer.
//
// Purcell 2002, section 3.2, the shadow caster: visibility by the standard graphics pipeline. Depth
// is near / z, so that its relative precision is the same at all distances, and there is no far
// plane.

//! include "raster/params.wgsl"

// The prim_ids of triangles that can be hit.
@group(1) @binding(0) var<storage, read> prim_ids: array<u32>;
// Vertices of all triangles: nine numbers each.
@group(1) @binding(1) var<storage, read> corners: array<f32>;

struct Vertex {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) prim_id: i32,
}

@vertex
fn project(@builtin(vertex_index) i: u32) -> Vertex {
    let prim_id = prim_ids[i / 3u];
    let view = params.view;
    let toward = corner_of(prim_id, i % 3u) - view.eye;
    let x = dot(toward, view.right) * 2.0 / (view.width * view.scale);
    let y = dot(toward, view.up) * 2.0 / (view.height * view.scale);
    return Vertex(vec4f(x, y, view.near, dot(toward, view.forward)), i32(prim_id));
}

@fragment
fn note(vertex: Vertex) -> @location(0) i32 {
    return vertex.prim_id;
}
