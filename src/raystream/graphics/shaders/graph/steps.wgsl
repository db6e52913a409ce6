// The steps of a traversal of a graph of sectors. As raystream/structures/graph/steps.py, which
// says why every search ends.

// A link is the row of a sector or, with this bit, of a link node.
const NODE_BIT: u32 = 0x80000000u;

// A face of a sector: the distance at which a ray meets its plane, and its link.
struct Way {
    t: f32,
    link: u32,
}

// The sector behind a link, and the number of link nodes on the way.
struct Crossing {
    sector: u32,
    node_count: u32,
}

// A sector's first block, and its number of triangles.
struct SectorBlocks {
    block: u32,
    triangle_count: u32,
}

fn low_corner(sector: u32) -> vec3f {
    return bitcast<vec3f>(sector_rows[sector].xyz);
}

fn high_corner(sector: u32) -> vec3f {
    return bitcast<vec3f>(sector_rows[sector + 1u].xyz);
}

fn sector_blocks(sector: u32) -> SectorBlocks {
    return SectorBlocks(sector_rows[sector].w, sector_rows[sector + 1u].w);
}

fn face_link(sector: u32, axis: u32, is_high: bool) -> u32 {
    let face = 2u * axis + u32(is_high);
    return sector_rows[sector + 2u + face / 4u][face % 4u];
}

// The face by which a ray leaves a sector: at FAR for the last one.
fn way_out(line: PlaneRay, sector: u32) -> Way {
    let is_up = line.inv > vec3f(0.0);
    let ends = select(low_corner(sector), high_corner(sector), is_up);
    let t = distances_to(line, ends, FAR);
    var axis = 0u;
    if t.y < t[axis] {
        axis = 1u;
    }
    if t.z < t[axis] {
        axis = 2u;
    }
    return Way(t[axis], face_link(sector, axis, is_up[axis]));
}

// The face by which a ray enters a sector: at -FAR for the first one.
fn way_back(line: PlaneRay, sector: u32) -> Way {
    let is_up = line.inv > vec3f(0.0);
    let ends = select(high_corner(sector), low_corner(sector), is_up);
    let t = distances_to(line, ends, -FAR);
    var axis = 0u;
    if t.y > t[axis] {
        axis = 1u;
    }
    if t.z > t[axis] {
        axis = 2u;
    }
    return Way(t[axis], face_link(sector, axis, !is_up[axis]));
}

// Follow a link, through link nodes, to the sector that holds a ray at t.
fn cross_face(line: PlaneRay, link: u32, t: f32) -> Crossing {
    var next = Crossing(link, 0u);
    while (next.sector & NODE_BIT) != 0u && spend_budget() {
        let node = sector_rows[next.sector ^ NODE_BIT];
        let is_behind = distance_to(line, node.y, bitcast<f32>(node.x)) <= t;
        let is_above = is_behind == (line.inv[node.y] > 0.0);
        next = Crossing(select(node.z, node.w, is_above), next.node_count + 1u);
    }
    return next;
}
