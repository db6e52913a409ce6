// Reflection at surfaces. As raystream/rendering/shading/bsdf.py, without glass and roughness.

//! include "bounces/surface.wgsl"
//! include "bounces/textures.wgsl"

// Columns of a material; see raystream/rendering/shading/tables.py.
const DIFFUSE: u32 = 0u;
const SPECULAR: u32 = 3u;
const REFLECTION: u32 = 6u;
const EMISSION: u32 = 12u;
const SHININESS: u32 = 15u;
const WIDTH: u32 = 22u;

const INV_PI: f32 = 0.318309886;
const INV_TWO_PI: f32 = 0.159154943;

struct Lobes {
    diffuse: vec3f,
    specular: vec3f,
    reflection: vec3f,
    shininess: f32,
}

fn material_number(material: u32, column: u32) -> f32 {
    return materials[WIDTH * material + column];
}

fn material_color(material: u32, column: u32) -> vec3f {
    let at = WIDTH * material + column;
    return vec3f(materials[at], materials[at + 1u], materials[at + 2u]);
}

// The lobes at a point, scaled down if their sum exceeds 1.
fn lobes_at(point: Point) -> Lobes {
    let texture = texture_color(point.material, point.texcoord);
    let diffuse = material_color(point.material, DIFFUSE) * point.color * texture;
    let specular = material_color(point.material, SPECULAR);
    let reflection = material_color(point.material, REFLECTION);
    let share = 1.0 / max(largest(diffuse + specular + reflection), 1.0);
    let shininess = material_number(point.material, SHININESS);
    return Lobes(diffuse * share, specular * share, reflection * share, shininess);
}

fn emitted(point: Point) -> vec3f {
    return material_color(point.material, EMISSION);
}

// The mirror direction of `back`, which points to where the ray came from.
fn mirrored(back: vec3f, normal: vec3f) -> vec3f {
    return 2.0 * dot(back, normal) * normal - back;
}

// Diffuse and glossy reflection, for an irradiance of 1 on a surface that faces the light
// (Lafortune and Willems 1994).
fn reflected(lobes: Lobes, point: Point, back: vec3f, toward: vec3f) -> vec3f {
    let cosine = dot(point.normal, toward);
    if !(cosine > 0.0 && dot(point.plane, toward) > 0.0) {
        return vec3f(0.0);
    }
    var color = lobes.diffuse * (cosine * INV_PI);
    let along = dot(mirrored(back, point.normal), toward);
    if along > 0.0 && largest(lobes.specular) > 0.0 {
        let highlight = pow(along, lobes.shininess) * INV_TWO_PI;
        color += lobes.specular * (highlight * (lobes.shininess + 2.0) * cosine);
    }
    return color;
}
