// Rows of hits: a buffer in which each fragment writes those of its ray. Where a ray keeps at most
// one hit, no_hit_rows.wgsl replaces this file, and a program writes only its render targets.

@group(2) @binding(0) var<storage, read_write> rows: array<Row>;

//! include "nearest_hits.wgsl"
