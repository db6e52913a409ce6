// Shading by all lights, without shadows. As raystream/rendering/shading/local_shading.py.

//! include "rendering/shade.wgsl"
//! include "rendering/punctual_lights.wgsl"

fn shade_hit(_t: f32) -> bool {
    if current.prim_id == MISS {
        gathered += current.weight * shading.background;
        return false;
    }
    let back = -normalize(current.direction);
    let point = surface_point(u32(current.prim_id), current.u, current.v, current.direction);
    let lobes = lobes_at(point);
    var color = lobes.diffuse * shading.ambient;
    if point.is_front {
        color += emitted(point);
    }
    for (var k = 0u; k < shading.light_count; k++) {
        let light = arriving(k, point);
        if light.is_valid {
            color += reflected(lobes, point, back, light.toward) * light.color;
        }
    }
    gathered += current.weight * color;
    return false;
}

fn shadow_of(path: Path, k: u32) -> Spawned {
    return NO_RAY;
}

fn onward_of(path: Path, branch: u32) -> Spawned {
    return NO_RAY;
}
