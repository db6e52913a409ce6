// The children of a node that a ray enters. As visit() of raystream/structures/bvh/steps.py.
//
// A key holds the distance at which the ray enters a child, as the bits of a nonnegative float,
// whose order is that of the floats; the lowest three bits are the child's lane. The highest bit
// distinguishes a key from NO_KEY, and is cleared on the stack.

const NO_KEY: u32 = 0u;
const IS_KEY: u32 = 0x80000000u;
const KEY_LANES: u32 = 7u;
const NODE: u32 = 16u;
const LINKS: u32 = 12u;

// Lanes 0 to 3, and 4 to 7.
struct Children {
    low_keys: vec4u,
    high_keys: vec4u,
    low_links: vec4i,
    high_links: vec4i,
}

// The intervals of a ray in four boxes; see box_interval().
struct Intervals {
    t_in: vec4f,
    t_out: vec4f,
}

fn planes_at(at: u32) -> vec4f {
    return bitcast<vec4f>(nodes[at]);
}

// Four children's planes: those of low x, high x, low y, ... are two vectors apart.
fn box_intervals(ray: Ray, at: u32) -> Intervals {
    let x = select(0u, 2u, is_down(ray.inv.x));
    let y = select(4u, 6u, is_down(ray.inv.y));
    let z = select(8u, 10u, is_down(ray.inv.z));
    let near_x = fma(planes_at(at + x), vec4f(ray.inv.x), vec4f(ray.near.x));
    let near_y = fma(planes_at(at + y), vec4f(ray.inv.y), vec4f(ray.near.y));
    let near_z = fma(planes_at(at + z), vec4f(ray.inv.z), vec4f(ray.near.z));
    let far_x = fma(planes_at(at + (x ^ 2u)), vec4f(ray.inv.x), vec4f(ray.far.x));
    let far_y = fma(planes_at(at + (y ^ 2u)), vec4f(ray.inv.y), vec4f(ray.far.y));
    let far_z = fma(planes_at(at + (z ^ 2u)), vec4f(ray.inv.z), vec4f(ray.far.z));
    return Intervals(max(max(near_x, near_y), near_z), min(min(far_x, far_y), far_z));
}

// NO_KEY for an absent child, and for one that the ray does not enter.
fn keys_of(ray: Ray, at: u32, links: vec4i, lanes: vec4u) -> vec4u {
    let boxes = box_intervals(ray, at);
    let enters = max(boxes.t_in, vec4f(ray.t_min)) <= min(boxes.t_out, vec4f(found.t_far));
    let distance = bitcast<vec4u>(max(boxes.t_in, vec4f(0.0)));
    let keys = (distance & vec4u(~(IS_KEY | KEY_LANES))) | lanes | vec4u(IS_KEY);
    return select(vec4u(NO_KEY), keys, enters & (links != vec4i(0)));
}

fn entered_children(ray: Ray, node: i32) -> Children {
    let at = NODE * u32(node);
    let low_links = bitcast<vec4i>(nodes[at + LINKS]);
    let high_links = bitcast<vec4i>(nodes[at + LINKS + 1u]);
    return Children(
        keys_of(ray, at, low_links, vec4u(0u, 1u, 2u, 3u)),
        keys_of(ray, at + 1u, high_links, vec4u(4u, 5u, 6u, 7u)),
        low_links,
        high_links,
    );
}

fn largest_key(children: Children) -> u32 {
    let four = max(children.low_keys, children.high_keys);
    return max(max(four.x, four.y), max(four.z, four.w));
}

fn without_key(children: Children, key: u32) -> Children {
    let none = vec4u(NO_KEY);
    let taken = vec4u(key);
    return Children(
        select(children.low_keys, none, children.low_keys == taken),
        select(children.high_keys, none, children.high_keys == taken),
        children.low_links,
        children.high_links,
    );
}

fn link_of(children: Children, key: u32) -> i32 {
    let lane = key & 3u;
    return select(children.low_links[lane], children.high_links[lane], (key & 4u) != 0u);
}

// The key as it is on the stack.
fn sort_key(key: u32) -> u32 {
    return key & ~IS_KEY;
}

// The largest key that can still hold a nearer hit, for any lane. A box may begin before 0.
fn t_key(t: f32) -> u32 {
    return (bitcast<u32>(max(t, 0.0)) & ~IS_KEY) | KEY_LANES;
}
