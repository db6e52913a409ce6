// What a search visits. Nothing is done with it here; page/record_visits.wgsl replaces this file.

//! include "visit_kinds.wgsl"

fn visited(kind: u32, number: u32) {}
