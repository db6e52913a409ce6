// DDA through a 3D lattice of cells: set-up and step. As raystream/structures/grid/dda.py, where
// the reasons are: distances are computed from the planes' positions, never accumulated.
//
// Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987;
// Purcell 2002, section 3.1.3.

struct Lattice {
    low: vec3f,
    size: vec3f,
    counts: vec3f,
}

// Constants of a ray in a lattice.
struct Line {
    inv: vec3f,
    // A plane's distance is fused(plane, inv, middle).
    middle: vec3f,
    // 1 or -1: step from a plane to the next one.
    step: vec3f,
    // Index of the last plane, which the ray never passes.
    end: vec3f,
    // Step from a cell to the next one.
    stride: vec3i,
}

// State of the traversal.
struct Walk {
    cell: i32,
    // Distance of the next plane of each axis; FAR for the last one.
    t_next: vec3f,
    // Index of the plane after that, and its distance.
    plane: vec3f,
    t_after: vec3f,
}

fn distance_of(number: vec3f, lattice: Lattice, line: Line) -> vec3f {
    return fused3(fused3(number, lattice.size, lattice.low), line.inv, line.middle);
}

// Distances of planes; FAR for those that the ray never passes.
fn next_distances(number: vec3f, lattice: Lattice, line: Line) -> vec3f {
    return select(distance_of(number, lattice, line), vec3f(FAR), number == line.end);
}

fn line_through(lattice: Lattice, ray: Ray) -> Line {
    let step = vec3f(
        with_sign(1.0, ray.inv.x),
        with_sign(1.0, ray.inv.y),
        with_sign(1.0, ray.inv.z),
    );
    let row = vec3i(1, i32(lattice.counts.x), i32(lattice.counts.x) * i32(lattice.counts.y));
    return Line(
        ray.inv,
        (ray.near + ray.far) * 0.5,
        step,
        select(vec3f(0.0), lattice.counts, step > vec3f(0.0)),
        row * vec3i(step),
    );
}

// The cell along each axis in which a ray is at distance t.
fn cells_at(t: f32, lattice: Lattice, line: Line, ray: Ray) -> vec3f {
    let origin = from_frame(ray.kz, ray.origin);
    let direction = from_frame(ray.kz, ray.direction);
    let ahead = max(line.step, vec3f(0.0));
    let most = lattice.counts - vec3f(1.0);
    let first = select(vec3f(0.0), most, line.step < vec3f(0.0));
    let last = most - first;
    // Step 1: an estimate, correct but for rounding; 0 on a flat axis.
    let size = select(lattice.size, vec3f(1.0), lattice.size == vec3f(0.0));
    let guess = (fused3(vec3f(t), direction, origin) - lattice.low) / size;
    var cell = floor(min(select(vec3f(0.0), guess, guess > vec3f(0.0)), most));
    // Step 2: the exact cell: forward, then back. One of the two loops does nothing.
    let far_t = vec3f(t);
    var left = u32(max(max(lattice.counts.x, lattice.counts.y), lattice.counts.z));
    while left != 0u {
        let passes = (cell != last) & (distance_of(cell + ahead, lattice, line) <= far_t);
        if !any(passes) {
            break;
        }
        cell += select(vec3f(0.0), line.step, passes);
        left -= 1u;
    }
    let behind = vec3f(1.0) - ahead;
    while left != 0u {
        let passes = (cell != first) & (distance_of(cell + behind, lattice, line) > far_t);
        if !any(passes) {
            break;
        }
        cell -= select(vec3f(0.0), line.step, passes);
        left -= 1u;
    }
    return cell;
}

// The state in the cell with these indices along the axes.
fn walk_from(lattice: Lattice, line: Line, cell: vec3f) -> Walk {
    let number = vec3i(cell);
    let counts = vec3i(lattice.counts);
    let first = cell + max(line.step, vec3f(0.0));
    let second = first + line.step;
    return Walk(
        number.x + counts.x * (number.y + counts.y * number.z),
        next_distances(first, lattice, line),
        second,
        next_distances(second, lattice, line),
    );
}

fn start_walk(lattice: Lattice, line: Line, ray: Ray, t: f32) -> Walk {
    return walk_from(lattice, line, cells_at(t, lattice, line, ray));
}

// Distance at which the ray leaves its cell; FAR where it never does.
fn cell_end(walk: Walk) -> f32 {
    return min(min(walk.t_next.x, walk.t_next.y), walk.t_next.z);
}

// Step to the next cell, across all planes at the cell's end, which is not FAR.
fn step_walk(lattice: Lattice, line: Line, walk: Walk) -> Walk {
    let passes = walk.t_next <= vec3f(cell_end(walk));
    let strides = select(vec3i(0), line.stride, passes);
    let plane = walk.plane + select(vec3f(0.0), line.step, passes);
    return Walk(
        walk.cell + strides.x + strides.y + strides.z,
        select(walk.t_next, walk.t_after, passes),
        plane,
        next_distances(plane, lattice, line),
    );
}
