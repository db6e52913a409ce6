// Surface points at hits. As raystream/rendering/shading/surface_points.py, with Wide for float64
// where it matters: for positions on a triangle, and off it.

// Vertex indices, three for each triangle; empty if no mesh has attributes.
@group(1) @binding(2) var<storage, read> faces: array<u32>;
// Of each vertex: normal, zero where a mesh has none; colour; texture coordinates.
@group(1) @binding(3) var<storage, read> vertices: array<f32>;
@group(1) @binding(4) var<storage, read> material_ids: array<u32>;
@group(1) @binding(5) var<storage, read> materials: array<f32>;

// As raystream/core/spawn.py.
const UNIT: f32 = 0x1p-24;
const WORLD_UNIT: f32 = 0x1p-50;

// Texture coordinates of a mesh without any.
const UNKNOWN: f32 = 1e30;

//! include "rendering/shading.wgsl"
//! include "rendering/corners.wgsl"
//! include "triangle.wgsl"
//! include "vertices.wgsl"

struct Point {
    // Local frame, on the triangle.
    x: Wide,
    y: Wide,
    z: Wide,
    // Unit normal of the triangle, facing the ray.
    plane: vec3f,
    // Unit shading normal, likewise.
    normal: vec3f,
    // Distance from the triangle at which a spawned ray starts.
    offset: f32,
    is_front: bool,
    color: vec3f,
    texcoord: vec2f,
    material: u32,
}

struct Vertex {
    normal: vec3f,
    color: vec3f,
    texcoord: vec2f,
}

fn vertex_of(number: u32) -> Vertex {
    let at = 8u * number;
    return Vertex(
        vec3f(vertices[at], vertices[at + 1u], vertices[at + 2u]),
        vec3f(vertices[at + 3u], vertices[at + 4u], vertices[at + 5u]),
        vec2f(vertices[at + 6u], vertices[at + 7u]),
    );
}

// Attributes interpolated between a triangle's vertices.
fn attributes_at(prim_id: u32, u: f32, v: f32) -> Vertex {
    if shading.has_attributes == 0u {
        return Vertex(vec3f(0.0), vec3f(1.0), vec2f(UNKNOWN));
    }
    let a = vertex_of(faces[3u * prim_id]);
    let b = vertex_of(faces[3u * prim_id + 1u]);
    let c = vertex_of(faces[3u * prim_id + 2u]);
    let w = 1.0 - u - v;
    return Vertex(
        w * a.normal + u * b.normal + v * c.normal,
        w * a.color + u * b.color + v * c.color,
        w * a.texcoord + u * b.texcoord + v * c.texcoord,
    );
}

fn largest(v: vec3f) -> f32 {
    return max(max(v.x, v.y), v.z);
}

// A coordinate interpolated between three vertices.
fn between(a: f32, p: Wide, q: Wide, u: f32, v: f32) -> Wide {
    return wide_sum(wide_sum(Wide(a, 0.0), times(u, p)), times(v, q));
}

fn offset_at(extent: f32, reach: f32) -> f32 {
    let units = min(16.0 * extent + 4.0 * reach, 14.0 * (params.max_coordinate + reach));
    return UNIT * units + WORLD_UNIT * shading.world_reach;
}

// a * b - c * d. A zero has the sign that it has on the CPU: of two frames around a normal, the sign
// of its third component decides, see around().
fn cross_part(a: Wide, b: Wide, c: Wide, d: Wide) -> f32 {
    let difference = wide_cross(a, b, c, d).high;
    if difference != 0.0 {
        return difference;
    }
    let are_zero = (a.high == 0.0 || b.high == 0.0) && (c.high == 0.0 || d.high == 0.0);
    let is_below = is_down(a.high) != is_down(b.high) && is_down(c.high) == is_down(d.high);
    return with_sign(0.0, select(1.0, -1.0, are_zero && is_below));
}

// The point of a hit; `toward` is the ray's direction.
fn surface_point(prim_id: u32, u: f32, v: f32, toward: vec3f) -> Point {
    let triangle = triangle_of(prim_id);
    let a = triangle.a;
    let px = exact_sum(triangle.b.x, -a.x);
    let py = exact_sum(triangle.b.y, -a.y);
    let pz = exact_sum(triangle.b.z, -a.z);
    let qx = exact_sum(triangle.c.x, -a.x);
    let qy = exact_sum(triangle.c.y, -a.y);
    let qz = exact_sum(triangle.c.z, -a.z);
    let x = between(a.x, px, qx, u, v);
    let y = between(a.y, py, qy, u, v);
    let z = between(a.z, pz, qz, u, v);
    var plane = vec3f(
        cross_part(py, qz, pz, qy),
        cross_part(pz, qx, px, qz),
        cross_part(px, qy, py, qx),
    );
    // Scaled before it is normalised: the square of a small area would underflow.
    plane /= largest(abs(plane));
    let is_front = dot(plane, toward) <= 0.0;
    plane *= select(-1.0, 1.0, is_front) / sqrt(dot(plane, plane));

    let low = min(min(a, triangle.b), triangle.c);
    let high = max(max(a, triangle.b), triangle.c);
    let offset = offset_at(largest(high - low), largest(abs(vec3f(x.high, y.high, z.high))));
    let vertex = attributes_at(prim_id, u, v);
    let normal = facing(vertex.normal, plane, toward);
    let material = material_ids[prim_id];
    return Point(x, y, z, plane, normal, offset, is_front, vertex.color, vertex.texcoord, material);
}

// A smooth normal on the plane's side; the plane's where there is none, or it faces away.
fn facing(smooth_normal: vec3f, plane: vec3f, toward: vec3f) -> vec3f {
    let square = dot(smooth_normal, smooth_normal);
    if !(square > 0.0) {
        return plane;
    }
    let side = select(1.0, -1.0, dot(smooth_normal, plane) < 0.0);
    let normal = smooth_normal * (side / sqrt(square));
    if dot(normal, toward) >= 0.0 {
        return plane;
    }
    return normal;
}

// Origin of a ray that leaves a point in a direction, local frame.
fn wide_origin(point: Point, toward: vec3f) -> WideVector {
    let away = select(point.offset, -point.offset, dot(point.plane, toward) < 0.0);
    return WideVector(
        wide_sum(point.x, exact_product(away, point.plane.x)),
        wide_sum(point.y, exact_product(away, point.plane.y)),
        wide_sum(point.z, exact_product(away, point.plane.z)),
    );
}

fn spawned(point: Point, toward: vec3f) -> vec3f {
    let origin = wide_origin(point, toward);
    return vec3f(origin.x.high, origin.y.high, origin.z.high);
}
