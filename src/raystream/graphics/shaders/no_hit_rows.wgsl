// Where no more than one hit of a ray is kept: takes the place of nearest_hits.wgsl.

fn keep(row: Row) {}

fn sort_rows() {}
