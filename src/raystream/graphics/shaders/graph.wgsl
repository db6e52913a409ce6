// The graph of sectors (Rayforce 2013). As raystream/structures/graph/traversal.py.

struct Tree {
    low: vec3f,
    // 0 in an empty graph.
    sector_count: u32,
    high: vec3f,
    bin_counts: vec3f,
    bin_low: vec3f,
    // Bins per unit of length.
    bin_scales: vec3f,
}

// First the sectors, four rows each: low corner and first block; high corner and number of
// triangles; links of the faces (low x, high x, low y, high y, low z, high z). Planes without a
// sector behind are at -FAR or FAR. Then the link nodes, a row each: plane, axis, link below the
// plane, link above.
@group(1) @binding(0) var<storage, read> sector_rows: array<vec4u>;
// Leaf blocks; see leaf_in_interval.wgsl.
@group(1) @binding(1) var<storage, read> blocks: array<vec4u>;
// Row of a sector near each bin.
@group(1) @binding(2) var<storage, read> bins: array<u32>;

//! include "leaf_in_interval.wgsl"
//! include "plane_distances.wgsl"
//! include "visits.wgsl"
//! include "graph/steps.wgsl"
//! include "graph/start.wgsl"

fn search(ray: Ray) {
    let part = searched_part(ray, params.tree.low, params.tree.high);
    if params.tree.sector_count == 0u || !(part.t_in < part.t_out) {
        return;
    }
    let line = plane_ray(ray);
    var sector = start_sector(line, ray, part.t_in);
    var t_in = part.t_in;
    while spend_budget() {
        visited(SECTOR, sector);
        tally.steps += 1u;
        let way = way_out(line, sector);
        let t_out = min(way.t, part.t_out);
        let triangles = sector_blocks(sector);
        if triangles.triangle_count != 0u {
            tally.leaves += 1u;
            test_blocks(ray, triangles.block, triangles.triangle_count, t_in, t_out);
        }
        // Hits in later sectors are not before this one's end.
        if is_over(t_out) || t_out >= part.t_out {
            return;
        }
        let next = cross_face(line, way.link, t_out);
        tally.link_nodes += next.node_count;
        sector = next.sector;
        t_in = t_out;
    }
}
