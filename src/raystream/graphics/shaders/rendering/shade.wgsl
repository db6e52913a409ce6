// Shades the hit of a pixel's ray, and gives the pixel its next ray: the same for all modes.
//
// As raystream/rendering/shading/pixel_rays.py, in whose order rays are traced: the paths of a
// bounce, then their shadow rays, then the paths of the next bounce. A ray to come is no record
// here: it is computed from the surface that it leaves.
//
// A mode's file has shade_hit(), shadow_of() and onward_of().

//! include "rendering/pixel.wgsl"
//! include "rendering/one_path.wgsl"

// A ray that a path spawns: a path, or a shadow ray.
struct Spawned {
    is_active: bool,
    // Local frame.
    origin: vec3f,
    // Of any length; t_max counts in it.
    direction: vec3f,
    t_max: f32,
    // The path's weight, or the light that a shadow ray brings if nothing blocks it.
    color: vec3f,
    pdf: f32,
}

const NO_RAY = Spawned(false, vec3f(0.0), vec3f(0.0, 0.0, 1.0), 0.0, vec3f(0.0), 0.0);

fn shadow_ray(k: u32) -> Spawned {
    let each = max(shading.shadow_count, 1u);
    return shadow_of(row_at(pixel.half, k / each), k % each);
}

// The pixel's next ray; inactive if it is finished.
fn next_ray() -> Spawned {
    while true {
        while pixel.source < pixel.source_count {
            let path = onward_of(row_at(1u - pixel.half, pixel.source), pixel.branch);
            pixel.branch += 1u;
            if pixel.branch == BRANCHES {
                pixel.branch = 0u;
                pixel.source += 1u;
            }
            if path.is_active {
                pixel.is_shadow = false;
                current = Path(path.color, MISS, 0.0, 0.0, vec3f(0.0), path.pdf);
                return path;
            }
        }
        while pixel.shadow < pixel.row_count * shading.shadow_count {
            let ray = shadow_ray(pixel.shadow);
            if ray.is_active {
                pixel.is_shadow = true;
                return ray;
            }
            pixel.shadow += 1u;
        }
        if pixel.bounce >= LAST_BOUNCE || pixel.row_count == 0u {
            break;
        }
        pixel.bounce += 1u;
        pixel.half = 1u - pixel.half;
        pixel.source = 0u;
        pixel.source_count = pixel.row_count;
        pixel.row_count = 0u;
        pixel.onward_count = 0u;
        pixel.shadow = 0u;
    }
    return NO_RAY;
}

// Add the light of the traced ray, whose nearest hit, if any, is `prim_id`, and note what it spawns.
fn shade_ray(direction: vec3f, prim_id: i32, hit: vec3f) {
    if pixel.is_shadow {
        if prim_id == MISS {
            gathered += shadow_ray(pixel.shadow).color;
        }
        pixel.shadow += 1u;
        return;
    }
    current.prim_id = prim_id;
    current.u = hit.y;
    current.v = hit.z;
    current.direction = direction;
    if shade_hit(hit.x) {
        put_row();
        pixel.row_count += 1u;
        if pixel.bounce < LAST_BOUNCE {
            count_onward();
        }
    }
}

// The direction of a ray and its end, as searches need them.
fn search_direction(ray: Spawned) -> vec4f {
    let power = power_for(ray.direction);
    return vec4f(ray.direction * power, select(ray.t_max / power, FAR, ray.t_max == FAR));
}
