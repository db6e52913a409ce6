// Replaces corners.wgsl beside a structure that has the vertices itself.
