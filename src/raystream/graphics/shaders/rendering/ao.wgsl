// Ambient occlusion: rays around the normal of the first hit, which bring white where nothing is
// near. As raystream/rendering/shading/ambient_occlusion.py.

//! include "rendering/shade.wgsl"
//! include "rendering/sampler.wgsl"
//! include "rendering/surface.wgsl"
//! include "rendering/warp.wgsl"

// Length of the rays, local frame.
override DISTANCE: f32 = 1.0;

// The first numbers of a pixel are for the place in it and on the lens.
const FIRST_DIMENSION: u32 = 4u;

fn shade_hit(_t: f32) -> bool {
    return current.prim_id != MISS;
}

fn shadow_of(path: Path, k: u32) -> Spawned {
    let point = surface_point(u32(path.prim_id), path.u, path.v, path.direction);
    let sample = shading.sample * shading.shadow_count + k;
    let numbers = draw_pair(shading.first_pixel + number, sample, FIRST_DIMENSION);
    let toward = around(cosine_hemisphere(numbers), point.normal);
    // Those that a smooth normal sends below the triangle hit it at once.
    if !(dot(toward, point.plane) > 0.0) {
        return NO_RAY;
    }
    let light = path.weight / f32(shading.shadow_count);
    // All start at one point, on the side of the camera.
    return Spawned(true, spawned(point, point.plane), toward, DISTANCE, light, FAR);
}

fn onward_of(_path: Path, _branch: u32) -> Spawned {
    return NO_RAY;
}
