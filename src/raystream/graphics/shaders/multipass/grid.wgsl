// The grid as kernels: set up, traverse, intersect (Purcell 2002, section 3.1). As
// raystream/machines/steps/grid.py; but distances of planes are recomputed from a cell's
// index, which gives the same numbers in fewer texels.

//! include "multipass/frame.wgsl"

// `outer` in the coarse lattice.
const COARSE: i32 = -1;

struct Place {
    cell: i32,
    // The coarse cell whose lattice the ray traverses, up to t_end.
    outer: i32,
    // References of its cell that are still to be tested.
    row: u32,
    end: u32,
    t_in: f32,
    t_end: f32,
}

fn place_at(texel: vec2i) -> Place {
    let place = textureLoad(places, texel, 0);
    let span = textureLoad(spans, texel, 0);
    return Place(i32(place.x), i32(place.y), place.z, place.w, span.x, span.y);
}

fn end_at(texel: vec2i, state: u32, at: Place) -> Targets {
    let place = vec4u(u32(at.cell), u32(at.outer), at.row, at.end);
    return end_kernel(texel, state, place, vec4f(at.t_in, at.t_end, 0.0, 0.0));
}

// The lattice that a ray traverses.
fn lattice_of(at: Place) -> Lattice {
    if at.outer == COARSE {
        return coarse_cells();
    }
    return fine_cells(at.outer, child_of(at.outer));
}

fn list_of(at: Place) -> List {
    if at.outer == COARSE {
        return coarse_list(at.cell);
    }
    return fine_list(child_of(at.outer), at.cell);
}

fn walk_at(lattice: Lattice, line: Line, cell: i32) -> Walk {
    return walk_from(lattice, line, cell_numbers(lattice, cell));
}

// Distance at which a ray leaves its cell.
fn end_of_cell(ray: Ray, at: Place) -> f32 {
    let lattice = lattice_of(at);
    return min(cell_end(walk_at(lattice, line_through(lattice, ray), at.cell)), at.t_end);
}

// The next cell of a ray that leaves its cell at t_out.
fn next_place(ray: Ray, at: Place, t_out: f32) -> Place {
    var lattice = lattice_of(at);
    var cell = at.cell;
    var next = Place(cell, at.outer, 0u, 0u, t_out, at.t_end);
    if t_out >= at.t_end && at.outer != COARSE {
        // Leave the lattice of a coarse cell for the next coarse cell.
        lattice = coarse_cells();
        cell = at.outer;
        next.outer = COARSE;
        next.t_end = FAR;
    }
    let line = line_through(lattice, ray);
    next.cell = step_walk(lattice, line, walk_at(lattice, line, cell)).cell;
    return next;
}

// Enter the lattice of a coarse cell.
fn enter_cell(ray: Ray, at: Place, child: i32) -> Place {
    let fine = fine_cells(at.cell, child);
    let walk = start_walk(fine, line_through(fine, ray), ray, at.t_in);
    return Place(walk.cell, at.cell, 0u, 0u, at.t_in, end_of_cell(ray, at));
}

// Find a ray's first cell.
@fragment
fn set_up(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, STARTING) {
        return nothing();
    }
    run_count = 1u;
    let ray = ray_at(texel);
    let part = enter_grid(ray);
    let is_active = params.tree.triangle_count != 0u && part.t_in <= part.t_out;
    if !is_active {
        return end_kernel(texel, end_state(), vec4u(), vec4f());
    }
    found.t_far = part.t_out;
    let lattice = coarse_cells();
    let walk = start_walk(lattice, line_through(lattice, ray), ray, part.t_in);
    return end_at(texel, TRAVERSING, Place(walk.cell, COARSE, 0u, 0u, part.t_in, FAR));
}

// Find the triangles of a ray's cell, or the next cell if it is empty.
@fragment
fn traverse(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, TRAVERSING) {
        return nothing();
    }
    let ray = ray_at(texel);
    var at = place_at(texel);
    var state = TRAVERSING;
    for (var i = 0u; i < TRAVERSAL_STEPS && state == TRAVERSING; i++) {
        if !count_step() {
            state = DONE;
            break;
        }
        tally.steps += 1u;
        let list = list_of(at);
        if list.begin == list.end {
            let t_out = end_of_cell(ray, at);
            if is_over(t_out) {
                state = end_state();
            } else {
                at = next_place(ray, at, t_out);
            }
            continue;
        }
        var child = NO_CHILD;
        if at.outer == COARSE {
            child = child_of(at.cell);
        }
        if child == NO_CHILD {
            tally.leaves += 1u;
            at.row = list.begin;
            at.end = list.end;
            state = INTERSECTING;
        } else {
            at = enter_cell(ray, at, child);
        }
    }
    return end_at(texel, state, at);
}

// Test a triangle of a ray's cell; after the last one, step to the next cell.
@fragment
fn intersect_cell(@builtin(position) position: vec4f) -> Targets {
    let texel = texel_at(position);
    if !begin_kernel(texel, INTERSECTING) {
        return nothing();
    }
    let ray = ray_at(texel);
    var at = place_at(texel);
    let t_out = end_of_cell(ray, at);
    var state = INTERSECTING;
    for (var i = 0u; i < INTERSECTIONS && state == INTERSECTING; i++) {
        if !count_step() {
            state = DONE;
            break;
        }
        test_reference(ray, reference_at(at.row, at.outer != COARSE), at.t_in, end_of_hits(t_out));
        at.row += 1u;
        if at.row == at.end || is_full() {
            if is_over(t_out) {
                state = end_state();
            } else {
                at = next_place(ray, at, t_out);
                state = TRAVERSING;
            }
        }
    }
    return end_at(texel, state, at);
}
