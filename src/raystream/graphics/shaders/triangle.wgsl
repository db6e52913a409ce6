// The one triangle test: watertight. As raystream/kernels/triangle.py, where the reasons are, with
// Wide for float64.
//
// Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", Journal of Computer Graphics
// Techniques 2(1), 2013.

struct Hit {
    is_hit: bool,
    t: f32,
    u: f32,
    v: f32,
}

struct Triangle {
    a: vec3f,
    b: vec3f,
    c: vec3f,
}

const NO_HIT = Hit(false, FAR, 0.0, 0.0);

// A vertex, in the order of the frame, sheared into the ray's frame, independently of others.
fn image_of(ray: Ray, vertex: vec3f) -> vec2f {
    let moved = rounded3(vertex - ray.origin);
    return vec2f(
        rounded(moved.x - rounded(ray.shear.x * moved.z)),
        rounded(moved.y - rounded(ray.shear.y * moved.z)),
    );
}

// -1, 0 or 1: on which side of the origin the line from a to b passes, a.x * b.y - a.y * b.x.
// Exact: where rounded products are equal, their rounding errors decide.
fn side_of(a: vec2f, b: vec2f) -> i32 {
    let left = rounded(a.x * b.y);
    let right = rounded(a.y * b.x);
    if left != right {
        return select(-1, 1, left > right);
    }
    let left_error = product_error(a.x, b.y, left);
    let right_error = product_error(a.y, b.x, right);
    return i32(left_error > right_error) - i32(left_error < right_error);
}

// Sign of a zero edge once the ray moves by (e, e * e), e to 0: the top-left rule.
fn moved_side(a: vec2f, b: vec2f) -> i32 {
    if a.y != b.y {
        return select(-1, 1, a.y > b.y);
    }
    return i32(b.x > a.x) - i32(b.x < a.x);
}

fn wide_edge(a: vec2f, b: vec2f) -> Wide {
    return wide_determinant(a.x, b.y, a.y, b.x);
}

// Distance to the triangle's plane, from its vertices in the order of the frame: sheared, those of
// a large triangle would lose all digits of a short distance.
fn plane_distance(ray: Ray, a: vec3f, b: vec3f, c: vec3f) -> f32 {
    let px = exact_sum(b.x, -a.x);
    let py = exact_sum(b.y, -a.y);
    let pz = exact_sum(b.z, -a.z);
    let qx = exact_sum(c.x, -a.x);
    let qy = exact_sum(c.y, -a.y);
    let qz = exact_sum(c.z, -a.z);
    let nx = wide_cross(py, qz, pz, qy);
    let ny = wide_cross(pz, qx, px, qz);
    let nz = wide_cross(px, qy, py, qx);
    let o = ray.origin;
    let d = ray.direction;
    let along = wide_sum(
        wide_sum(
            wide_product(exact_sum(a.x, -o.x), nx),
            wide_product(exact_sum(a.y, -o.y), ny),
        ),
        wide_product(exact_sum(a.z, -o.z), nz),
    );
    let speed = wide_sum(wide_sum(times(d.x, nx), times(d.y, ny)), times(d.z, nz));
    if speed.high == 0.0 {
        return select(-FAR, FAR, along.high > 0.0);
    }
    return wide_quotient(along, speed);
}

// The vertices in the ray's frame.
struct Images {
    a: vec2f,
    b: vec2f,
    c: vec2f,
}

fn images_of(ray: Ray, triangle: Triangle) -> Images {
    return Images(
        image_of(ray, to_frame(ray.kz, triangle.a)),
        image_of(ray, to_frame(ray.kz, triangle.b)),
        image_of(ray, to_frame(ray.kz, triangle.c)),
    );
}

// Whether the line through a ray crosses a triangle, by the exact signs of its edges: most
// triangles end here, and the rest of the test takes ten times as long. With SURFACES a ray through
// an edge or a vertex crosses one triangle each time that it crosses the surface, else all of them.
fn is_crossed(images: Images) -> bool {
    var u_side = side_of(images.c, images.b);
    var v_side = side_of(images.a, images.c);
    var w_side = side_of(images.b, images.a);
    let lowest = min(min(u_side, v_side), w_side);
    let highest = max(max(u_side, v_side), w_side);
    if (lowest < 0 && highest > 0) || (lowest == 0 && highest == 0) {
        return false;
    }
    if SURFACES && lowest <= 0 && highest >= 0 {
        u_side = select(u_side, moved_side(images.c, images.b), u_side == 0);
        v_side = select(v_side, moved_side(images.a, images.c), v_side == 0);
        w_side = select(w_side, moved_side(images.b, images.a), w_side == 0);
        return min(min(u_side, v_side), w_side) > 0 || max(max(u_side, v_side), w_side) < 0;
    }
    return true;
}

// The hit of the line through a ray and a triangle that it crosses, at any t.
fn crossing(ray: Ray, triangle: Triangle) -> Hit {
    // Step 1: weights. All have one sign, so their sum does not cancel.
    let images = images_of(ray, triangle);
    let u_weight = wide_edge(images.c, images.b);
    let v_weight = wide_edge(images.a, images.c);
    let w_weight = wide_edge(images.b, images.a);
    let sum = wide_sum(wide_sum(u_weight, v_weight), w_weight);
    if sum.high == 0.0 {
        return NO_HIT;
    }

    // Step 2: the distance to the plane, clamped to the triangle's own padded interval, so that
    // it lies in that of every box around the triangle. Adding zero turns -0 into 0.
    let low = min(min(triangle.a, triangle.b), triangle.c);
    let high = max(max(triangle.a, triangle.b), triangle.c);
    let own = box_interval(ray, low, high);
    var t = plane_distance(
        ray,
        to_frame(ray.kz, triangle.a),
        to_frame(ray.kz, triangle.b),
        to_frame(ray.kz, triangle.c),
    );
    t = select(own.t_in, t, t > own.t_in);
    t = select(own.t_out, t, t < own.t_out) + 0.0;
    let u = wide_quotient(v_weight, sum) + 0.0;
    let v = wide_quotient(w_weight, sum) + 0.0;
    return Hit(own.t_in <= own.t_out, t, u, v);
}

// Intersect the line through a ray with a triangle, at any t. Over many triangles, first search for
// the next one that is_crossed(): the invocations of a subgroup wait for each other.
fn intersect(ray: Ray, triangle: Triangle) -> Hit {
    if !is_crossed(images_of(ray, triangle)) {
        return NO_HIT;
    }
    return crossing(ray, triangle);
}
