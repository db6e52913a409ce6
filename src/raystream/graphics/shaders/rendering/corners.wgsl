// Vertices of all triangles, for vertices.wgsl.

@group(1) @binding(1) var<storage, read> corners: array<f32>;
