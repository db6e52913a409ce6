// Rows of hits: a buffer that fragments write, each those of its own ray. Where a ray keeps one hit
// at most, no_hit_rows.wgsl takes this file's place, and a program writes nothing but its targets.

@group(2) @binding(0) var<storage, read_write> rows: array<Row>;

//! include "nearest_hits.wgsl"
