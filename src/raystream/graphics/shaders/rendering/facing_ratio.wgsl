// Grey, by the cosine between normal and view. As raystream/rendering/shading/local_shading.py.

//! include "rendering/shade.wgsl"
//! include "rendering/surface.wgsl"

fn shade_hit(_t: f32) -> bool {
    if current.prim_id == MISS {
        gathered += current.weight * shading.background;
        return false;
    }
    let toward = normalize(current.direction);
    let point = surface_point(u32(current.prim_id), current.u, current.v, toward);
    gathered += current.weight * abs(dot(point.normal, toward));
    return false;
}

fn shadow_of(path: Path, k: u32) -> Spawned {
    return NO_RAY;
}

fn onward_of(path: Path, branch: u32) -> Spawned {
    return NO_RAY;
}
