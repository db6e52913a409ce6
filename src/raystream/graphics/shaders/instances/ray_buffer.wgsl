// Rays of compute shaders in a scene with instances: in the frame of the tree over the instances, and
// in world space. Replaces ray_buffer.wgsl. As raystream/graphics/instanced_rays.py packs them.

// The bits of floats, of doubles and of integers.
@group(0) @binding(1) var<storage, read> rays: array<vec4u>;

const RAY_ROWS: u32 = 7u;

//! include "float64.wgsl"

// The space that a search is in: world t = local t * 2^t_exponent + t_offset.
struct Space {
    t_exponent: i32,
    t_offset: vec2u,
    // Added to a prim_id, it is the number of the triangle among those of all instances.
    first_id: i32,
}

struct WorldRay {
    origin: array<vec2u, 3>,
    direction: array<vec2u, 3>,
    t_min: f32,
    world: i32,
    // That of the tree over the instances.
    space: Space,
}

var<private> world_ray: WorldRay;
// Hits beyond are ignored, in world direction lengths.
var<private> world_far: f32;
var<private> space: Space;

fn load_ray(i: u32) -> Ray {
    let at = RAY_ROWS * i;
    let a = rays[at + 2u];
    let b = rays[at + 3u];
    let c = rays[at + 4u];
    let d = rays[at + 5u];
    let e = rays[at + 6u];
    space = Space(bitcast<i32>(e.z), e.xy, 0);
    world_ray.origin = array(a.xy, a.zw, b.xy);
    world_ray.direction = array(b.zw, c.xy, c.zw);
    world_ray.t_min = bitcast<f32>(d.x);
    world_ray.world = bitcast<i32>(d.w);
    world_ray.space = space;
    world_far = bitcast<f32>(d.y);
    let from_ = bitcast<vec4f>(rays[at]);
    let to = bitcast<vec4f>(rays[at + 1u]);
    return prepare_ray(from_.xyz, to.xyz, vec2f(from_.w, to.w), bitcast<f32>(d.z));
}
