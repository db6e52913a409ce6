// A world ray in the space of an instance's object: moved in float64, then made local, with the bits
// that the CPU has. As raystream/geometry/instances/traversal.py and raystream/kernels/ray.py.

// Instances, world to object space, of INSTANCE_ROWS rows; then objects, of OBJECT_ROWS rows; then
// roots of trees. As raystream/graphics/structures/instances.py.
@group(1) @binding(2) var<storage, read> places: array<vec4u>;

const INSTANCE_ROWS: u32 = 7u;
const OBJECT_ROWS: u32 = 4u;

// Origins are advanced if they are further outside of the object's box than this many times its
// largest coordinate; those that are nearer by far need no exact test.
const FAR_EXPONENT: i32 = 2;
const NEAR_REACH: f32 = 2.9;

// Coordinates beyond this, 2^200, make a ray invalid.
const MOST_COORDINATE = vec2u(0u, 0x4c700000u);

struct Object {
    // Its row in `places`, where its centre is.
    at: u32,
    scale_exponent: i32,
    max_coordinate: f32,
    low: vec3f,
    high: vec3f,
    // The root of its tree; or its first row in a list, and the end of its rows.
    first: i32,
    end: i32,
}

fn object_of(id: u32) -> Object {
    let at = params.tree.object_at + OBJECT_ROWS * id;
    let numbers = places[at + 1u];
    let low = places[at + 2u];
    let high = places[at + 3u];
    return Object(
        at,
        bitcast<i32>(numbers.z),
        bitcast<f32>(numbers.w),
        bitcast<vec3f>(low.xyz),
        bitcast<vec3f>(high.xyz),
        bitcast<i32>(low.w),
        bitcast<i32>(high.w),
    );
}

// The double with a number, counted from the beginning of a row.
fn double_at(row: u32, number: u32) -> vec2u {
    let two = places[row + number / 2u];
    return select(two.xy, two.zw, (number & 1u) == 1u);
}

// A row of the matrix, times a vector: products and their sum from left to right.
fn row_product(instance: u32, axis: u32, v: array<vec2u, 3>) -> vec2u {
    let x = double_product(double_at(instance, 3u * axis), v[0]);
    let y = double_product(double_at(instance, 3u * axis + 1u), v[1]);
    let z = double_product(double_at(instance, 3u * axis + 2u), v[2]);
    return double_sum(double_sum(x, y), z);
}

struct ObjectRay {
    origin: array<vec2u, 3>,
    // The largest component is in [1, 2).
    direction: array<vec2u, 3>,
}

var<private> moved: ObjectRay;

// Distance at which the line enters the object's box, padded by its size; INFINITE for a miss.
fn entry_distance(object: Object) -> vec2u {
    let margin = widened(object.max_coordinate);
    var t_in = negated(INFINITE);
    var t_out = INFINITE;
    for (var axis = 0u; axis < 3u; axis++) {
        let o = moved.origin[axis];
        let d = moved.direction[axis];
        let to_low = double_difference(double_difference(widened(object.low[axis]), margin), o);
        let to_high = double_difference(double_sum(widened(object.high[axis]), margin), o);
        if exponent_bits(d) == 0 {
            if is_less(vec2u(), to_low) || is_less(to_high, vec2u()) {
                return INFINITE;
            }
            continue;
        }
        let t_low = double_quotient(to_low, d);
        let t_high = double_quotient(to_high, d);
        t_in = larger(t_in, smaller(t_low, t_high));
        t_out = smaller(t_out, larger(t_low, t_high));
    }
    return select(t_in, INFINITE, is_less(t_out, t_in));
}

// Whether the origin is so far outside of the object's box that it is advanced.
fn is_far(object: Object) -> bool {
    var outside = negated(INFINITE);
    for (var axis = 0u; axis < 3u; axis++) {
        let o = moved.origin[axis];
        outside = larger(outside, double_difference(widened(object.low[axis]), o));
        outside = larger(outside, double_difference(o, widened(object.high[axis])));
    }
    return is_less(scaled(widened(object.max_coordinate), FAR_EXPONENT), outside);
}

// Advance the origin to the object's box, in two steps: the second one corrects the first's
// rounding. Returns the distance; INFINITE if the line misses the box.
fn advance_origin(object: Object) -> vec2u {
    var total = vec2u();
    for (var turn = 0u; turn < 2u; turn++) {
        let t = entry_distance(object);
        if t.y == INFINITE.y {
            return INFINITE;
        }
        for (var axis = 0u; axis < 3u; axis++) {
            let way = double_product(t, moved.direction[axis]);
            moved.origin[axis] = double_sum(moved.origin[axis], way);
        }
        total = double_sum(total, t);
    }
    return total;
}

// A ray that finds nothing.
fn no_ray() -> Ray {
    return prepare_ray(vec3f(), vec3f(1.0), vec2f(1.0, 0.0), 1.0);
}

// Move the ray to the space of an instance, where the search continues; no_ray() if it is invalid
// there, or cannot meet the object.
fn enter_instance(number: u32, object: Object) -> Ray {
    // Step 1: by the inverse matrix, then to the object's centre and scale.
    let instance = INSTANCE_ROWS * number;
    var is_valid = true;
    var length = 0;
    for (var axis = 0u; axis < 3u; axis++) {
        let shift = double_at(instance, 9u + axis);
        let point = double_sum(row_product(instance, axis, world_ray.origin), shift);
        is_valid = is_valid && !is_less(MOST_COORDINATE, magnitude(point));
        let centred = double_difference(point, double_at(object.at, axis));
        moved.origin[axis] = scaled(centred, object.scale_exponent);
        moved.direction[axis] = row_product(instance, axis, world_ray.direction);
        length = max(length, exponent_bits(moved.direction[axis]));
    }
    if !is_valid || length == 0 || length >= 2047 {
        return no_ray();
    }
    for (var axis = 0u; axis < 3u; axis++) {
        moved.direction[axis] = scaled(moved.direction[axis], BIAS - length);
    }
    let t_exponent = BIAS - length - object.scale_exponent;
    space = Space(t_exponent, vec2u(), bitcast<i32>(places[instance + 6u].y));

    // Step 2: advance an origin that is far outside.
    let reach = vec3f(NEAR_REACH * object.max_coordinate);
    if any(abs(moved_origin()) > reach) && is_far(object) {
        let total = advance_origin(object);
        if total.y == INFINITE.y {
            return no_ray();
        }
        space.t_offset = scaled(total, t_exponent);
    }

    // Step 3: limits; hits are tested again as they are reported.
    found.t_far = local_limit(world_far, 1.0);
    let limits = vec2f(local_limit(world_ray.t_min, -1.0), found.t_far);
    let d = moved.direction;
    let direction = vec3f(narrowed(d[0]), narrowed(d[1]), narrowed(d[2]));
    return prepare_ray(moved_origin(), direction, limits, object.max_coordinate);
}

fn moved_origin() -> vec3f {
    let o = moved.origin;
    return vec3f(narrowed(o[0]), narrowed(o[1]), narrowed(o[2]));
}

// Continue in the tree over the instances.
fn leave_instance() {
    space = world_ray.space;
    found.t_far = local_limit(world_far, 1.0);
}
