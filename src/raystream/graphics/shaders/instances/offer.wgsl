// Hits in instances: kept by t in world direction lengths, and by the number of the triangle among
// those of all instances. Replaces offer.wgsl. As raystream/kernels/search.py.

// A float of float64's rounding, and the steps of small floats: added to limits.
const LEAST_STEP = vec2u(0u, 0x36c00000u); // 2^-147
const LIMIT_SHARE: f32 = 0x1p-22;
const LIMIT_LEAST: f32 = 0x1p-120;

// A local distance as it is reported.
fn reported_t(t: f32) -> f32 {
    return narrowed(double_sum(scaled(widened(t), space.t_exponent), space.t_offset));
}

// A local distance beyond which all are reported as more than t; or with a sign of -1, below which
// all are reported as less. Not the nearest one: offer() compares what is reported.
fn local_limit(t: f32, sign: f32) -> f32 {
    if abs(t) >= FAR {
        return t;
    }
    let exact = widened(t * sign);
    let offset = vec2u(space.t_offset.x, space.t_offset.y ^ (bitcast<u32>(sign) & SIGN));
    let share = double_sum(scaled(magnitude(exact), -22), scaled(magnitude(offset), -48));
    let beyond = double_sum(exact, double_sum(share, LEAST_STEP));
    let near = narrowed(scaled(double_difference(beyond, offset), -space.t_exponent));
    if abs(near) >= 0.5 * FAR {
        return sign * select(-0.5 * FAR, FAR, near > 0.0);
    }
    return sign * (near + (abs(near) * LIMIT_SHARE + LIMIT_LEAST));
}

// Offer a hit: once for each triangle of an instance.
fn offer(hit: Hit, prim_id: i32) {
    let t = reported_t(hit.t);
    if t < world_ray.t_min || t > world_far {
        return;
    }
    let local_far = found.t_far;
    found.t_far = world_far;
    take(Hit(true, t, hit.u, hit.v), prim_id + space.first_id);
    if found.t_far == world_far {
        found.t_far = local_far;
        return;
    }
    world_far = found.t_far;
    found.t_far = local_limit(world_far, 1.0);
}
