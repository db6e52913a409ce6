// Replaces nearest_hits.wgsl where at most one hit of a ray is kept.

fn keep(row: Row) {}

fn sort_rows() {}
