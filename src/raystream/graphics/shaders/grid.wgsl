// The uniform grid, of one level or two. As raystream/structures/grid/traversal.py and cells.py.

struct Tree {
    low: vec3f,
    high: vec3f,
    size: vec3f,
    counts: vec3f,
    // Whether cells may have lattices of the second level.
    is_divided: u32,
    // 0 in an empty grid.
    triangle_count: u32,
}

// Cell i has the triangles references[splits[i]] to references[splits[i + 1]].
@group(1) @binding(0) var<storage, read> splits: array<u32>;
@group(1) @binding(1) var<storage, read> references: array<u32>;
@group(1) @binding(2) var<storage, read> corners: array<f32>;
// Index of the lattice in each cell, or NO_CHILD.
@group(1) @binding(3) var<storage, read> children: array<i32>;
// First cell of each lattice, and its cells along the axes.
@group(1) @binding(4) var<storage, read> lattices: array<vec4u>;
@group(1) @binding(5) var<storage, read> fine_splits: array<u32>;
@group(1) @binding(6) var<storage, read> fine_references: array<u32>;

const NO_CHILD: i32 = -1;

//! include "vertices.wgsl"
//! include "dda.wgsl"
//! include "visits.wgsl"

// The references of a cell.
struct List {
    begin: u32,
    end: u32,
}

// The part of a ray's interval in the grid; empty if t_in > t_out.
fn enter_grid(ray: Ray) -> Interval {
    let part = box_interval(ray, params.tree.low, params.tree.high);
    return Interval(max(ray.t_min, part.t_in), min(ray.t_max, part.t_out));
}

fn coarse_cells() -> Lattice {
    return Lattice(params.tree.low, params.tree.size, params.tree.counts);
}

// Indices of a cell along the axes.
fn cell_numbers(lattice: Lattice, cell: i32) -> vec3f {
    let counts = vec3i(lattice.counts);
    return vec3f(vec3i(cell % counts.x, cell / counts.x % counts.y, cell / (counts.x * counts.y)));
}

fn child_of(cell: i32) -> i32 {
    if params.tree.is_divided == 0u {
        return NO_CHILD;
    }
    return children[cell];
}

// The lattice within a coarse cell.
fn fine_cells(cell: i32, child: i32) -> Lattice {
    let counts = vec3f(lattices[child].yzw);
    let low = fused3(cell_numbers(coarse_cells(), cell), params.tree.size, params.tree.low);
    return Lattice(low, rounded3(params.tree.size / counts), counts);
}

fn coarse_list(cell: i32) -> List {
    return List(splits[cell], splits[cell + 1]);
}

fn fine_list(child: i32, cell: i32) -> List {
    let at = lattices[child].x + u32(cell);
    return List(fine_splits[at], fine_splits[at + 1u]);
}

// The triangle in a row of a list.
fn reference_at(row: u32, is_fine: bool) -> u32 {
    if is_fine {
        return fine_references[row];
    }
    return references[row];
}

// Offer a triangle's hit if t_in <= t < t_out: others belong to other cells.
fn test_reference(ray: Ray, prim_id: u32, t_in: f32, t_out: f32) {
    tally.tests += 1u;
    let hit = intersect(ray, triangle_of(prim_id));
    if hit.is_hit && hit.t >= t_in && hit.t < t_out && hit.t <= found.t_far {
        offer(hit, i32(prim_id));
    }
}

// Any-hit queries accept a hit at any t.
fn end_of_hits(t_out: f32) -> f32 {
    return select(t_out, FAR, QUERY == ANY_HIT);
}

fn test_list(ray: Ray, list: List, is_fine: bool, t_in: f32, t_out: f32) {
    if list.begin != list.end {
        tally.leaves += 1u;
    }
    for (var row = list.begin; row != list.end; row++) {
        if is_full() || !spend_budget() {
            return;
        }
        test_reference(ray, reference_at(row, is_fine), t_in, end_of_hits(t_out));
    }
}

// Visit the fine cells of a coarse cell, from t_in to t_end.
fn visit_fine(ray: Ray, cell: i32, child: i32, start: f32, t_end: f32) {
    let lattice = fine_cells(cell, child);
    let line = line_through(lattice, ray);
    var walk = start_walk(lattice, line, ray, start);
    var t_in = start;
    while spend_budget() {
        let t_out = min(cell_end(walk), t_end);
        visited(FINE_CELL, lattices[child].x + u32(walk.cell));
        tally.steps += 1u;
        test_list(ray, fine_list(child, walk.cell), true, t_in, t_out);
        if is_over(t_out) || t_out >= t_end {
            return;
        }
        walk = step_walk(lattice, line, walk);
        t_in = t_out;
    }
}

fn search(ray: Ray) {
    let part = enter_grid(ray);
    if params.tree.triangle_count == 0u || !(part.t_in <= part.t_out) {
        return;
    }
    found.t_far = part.t_out;
    let lattice = coarse_cells();
    let line = line_through(lattice, ray);
    var walk = start_walk(lattice, line, ray, part.t_in);
    var t_in = part.t_in;
    while spend_budget() {
        let t_out = cell_end(walk);
        visited(CELL, u32(walk.cell));
        tally.steps += 1u;
        let list = coarse_list(walk.cell);
        if list.begin != list.end {
            let child = child_of(walk.cell);
            if child == NO_CHILD {
                test_list(ray, list, false, t_in, t_out);
            } else {
                visit_fine(ray, walk.cell, child, t_in, t_out);
            }
        }
        // A hit at the cell's end is in the next cell, and may tie with one at t_far.
        if is_over(t_out) {
            return;
        }
        walk = step_walk(lattice, line, walk);
        t_in = t_out;
    }
}
