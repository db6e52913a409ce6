// Shadow rays to every light, and rays continued by mirrors and glass. As
// raystream/rendering/shading/whitted.py.

//! include "rendering/shade.wgsl"
//! include "rendering/punctual_lights.wgsl"

fn point_of(path: Path) -> Point {
    return surface_point(u32(path.prim_id), path.u, path.v, path.direction);
}

fn shade_hit(t: f32) -> bool {
    if current.prim_id == MISS {
        gathered += current.weight * shading.background;
        return false;
    }
    let point = point_of(current);
    if point.is_front {
        gathered += current.weight * emitted(point);
    } else {
        current.weight *= transmittance(point, t * length(current.direction));
    }
    let lobes = lobes_at(point);
    gathered += current.weight * (lobes.diffuse * shading.ambient);
    if !CASTS_SHADOWS {
        let back = -normalize(current.direction);
        for (var k = 0u; k < shading.light_count; k++) {
            let light = arriving(k, point);
            if light.is_valid {
                let color = reflected(lobes, point, back, light.toward);
                gathered += current.weight * (color * light.color);
            }
        }
    }
    return true;
}

// The ray to a light, unless it has no effect.
fn shadow_of(path: Path, k: u32) -> Spawned {
    let point = point_of(path);
    let light = arriving(k, point);
    if !light.is_valid {
        return NO_RAY;
    }
    let color = reflected(lobes_at(point), point, -normalize(path.direction), light.toward);
    if color.x + color.y + color.z <= 0.0 {
        return NO_RAY;
    }
    return ray_to(point, light, path.weight * color * light.color);
}

fn continued(path: Path, point: Point, toward: vec3f, color: vec3f) -> Spawned {
    let weight = path.weight * color;
    if !(largest(weight) > shading.min_weight) {
        return NO_RAY;
    }
    return Spawned(true, spawned(point, toward), toward, FAR, weight, FAR);
}

// What a mirror reflects, the last branch; before it, what glass refracts.
fn onward_of(path: Path, branch: u32) -> Spawned {
    let point = point_of(path);
    let lobes = lobes_at(point);
    let back = -normalize(path.direction);
    let through = lobes.transmission;
    var clear = 0.0;
    if through.x + through.y + through.z > 0.0 && lobes.ior != 1.0 {
        clear = fresnel(min(dot(back, point.normal), 1.0), lobes.ior);
    }
    if branch + 1u == BRANCHES {
        let toward = mirrored(back, point.normal);
        if dot(point.plane, toward) > 0.0 {
            return continued(path, point, toward, lobes.reflection + clear * through);
        }
        return NO_RAY;
    }
    if !(through.x + through.y + through.z > 0.0) || clear >= 1.0 {
        return NO_RAY;
    }
    let toward = refracted(back, point.normal, lobes.ior);
    if dot(point.plane, toward) < 0.0 {
        return continued(path, point, toward, (1.0 - clear) * through);
    }
    return NO_RAY;
}
