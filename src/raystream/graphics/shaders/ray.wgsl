// A ray prepared for tests: reciprocals for slabs, a sheared frame for triangles.
// As raystream/kernels/ray.py and slab.py, where the reasons are.

const PAD: f32 = 0x1p-20;
const TINY_DIRECTION: f32 = 0x1p-40;

// In place of infinity, which WGSL does not guarantee.
const FAR: f32 = 0x1.fffffep+127;

struct Ray {
    // The axis of the frame's z: that of the largest component of the direction.
    kz: u32,
    // In the order of the frame.
    origin: vec3f,
    direction: vec3f,
    shear: vec3f,
    // In world order: a slab's distances are fma(plane, inv, near) and fma(plane, inv, far).
    inv: vec3f,
    near: vec3f,
    far: vec3f,
    t_min: f32,
    t_max: f32,
}

struct Interval {
    t_in: f32,
    t_out: f32,
}

// A vector's components in the order of the frame: z along axis kz, then x and y cyclically.
fn to_frame(kz: u32, v: vec3f) -> vec3f {
    return select(select(v, v.zxy, kz == 1u), v.yzx, kz == 0u);
}

// A vector in the order of the frame, in world order.
fn from_frame(kz: u32, v: vec3f) -> vec3f {
    return select(select(v, v.yzx, kz == 1u), v.zxy, kz == 0u);
}

// |size| with the sign of x, that of -0, too: a ray along -0 goes down.
fn with_sign(size: f32, x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(abs(size)) | (bitcast<u32>(x) & 0x80000000u));
}

fn is_down(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x80000000u) != 0u;
}

fn reciprocal(d: f32, tiny: f32) -> f32 {
    return with_sign(quotient(1.0, max(abs(d), tiny)), d);
}

// Prepare a ray in the local frame, whose largest direction component is in [1, 2).
fn set_up_ray(origin: vec3f, direction: vec3f, t_min: f32, t_max: f32) -> Ray {
    return prepare_ray(origin, direction, vec2f(t_min, t_max), params.max_coordinate);
}

// The same in a frame with another largest coordinate; limits are t_min and t_max.
fn prepare_ray(origin: vec3f, direction: vec3f, limits: vec2f, max_coordinate: f32) -> Ray {
    // Step 1: the frame's z axis is the largest component; the first one wins a tie.
    let size = abs(direction);
    var kz = 0u;
    var largest = size.x;
    if size.y > largest {
        kz = 1u;
        largest = size.y;
    }
    if size.z > largest {
        kz = 2u;
        largest = size.z;
    }

    // Step 2: slab constants. The padding moves each near plane towards the origin and each far
    // plane away from it, so it takes the direction's sign.
    let tiny = largest * TINY_DIRECTION;
    let reach = max(max(abs(origin.x), abs(origin.y)), abs(origin.z));
    let pad = rounded(PAD * rounded(max_coordinate + reach));
    let inv = vec3f(
        reciprocal(direction.x, tiny),
        reciprocal(direction.y, tiny),
        reciprocal(direction.z, tiny),
    );
    let pads = vec3f(
        with_sign(pad, direction.x),
        with_sign(pad, direction.y),
        with_sign(pad, direction.z),
    );
    let near = -rounded3(rounded3(origin + pads) * inv);
    let far = -rounded3(rounded3(origin - pads) * inv);

    // Step 3: the shear.
    let d = to_frame(kz, direction);
    let sz = to_frame(kz, inv).z;
    let shear = vec3f(rounded(d.x * sz), rounded(d.y * sz), sz);
    return Ray(kz, to_frame(kz, origin), d, shear, inv, near, far, limits.x, limits.y);
}

fn rounded3(v: vec3f) -> vec3f {
    return vec3f(rounded(v.x), rounded(v.y), rounded(v.z));
}

// The part of a ray in a box grown by the ray's padding; empty if t_in > t_out. Monotone in each
// plane, so that a box inside another has an interval inside the other's.
fn box_interval(ray: Ray, low: vec3f, high: vec3f) -> Interval {
    let down = vec3<bool>(is_down(ray.inv.x), is_down(ray.inv.y), is_down(ray.inv.z));
    let near = fma(select(low, high, down), ray.inv, ray.near);
    let far = fma(select(high, low, down), ray.inv, ray.far);
    return Interval(max(max(near.x, near.y), near.z), min(min(far.x, far.y), far.z));
}
