// Reflection at surfaces. As raystream/rendering/shading/bsdf.py, without roughness.

//! include "rendering/surface.wgsl"
//! include "rendering/textures.wgsl"

// Columns of a material; see raystream/rendering/shading/tables.py.
const DIFFUSE: u32 = 0u;
const SPECULAR: u32 = 3u;
const REFLECTION: u32 = 6u;
const TRANSMISSION: u32 = 9u;
const EMISSION: u32 = 12u;
const SHININESS: u32 = 15u;
const IOR: u32 = 16u;
const ABSORPTION: u32 = 19u;
const WIDTH: u32 = 22u;

const INV_PI: f32 = 0.318309886;
const INV_TWO_PI: f32 = 0.159154943;

struct Lobes {
    diffuse: vec3f,
    specular: vec3f,
    reflection: vec3f,
    transmission: vec3f,
    shininess: f32,
    // Index of refraction of the medium that the ray enters over that of the one it leaves.
    ior: f32,
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
    let transmission = material_color(point.material, TRANSMISSION);
    let share = 1.0 / max(largest(diffuse + specular + reflection + transmission), 1.0);
    let shininess = material_number(point.material, SHININESS);
    let ior = max(material_number(point.material, IOR), 1e-3);
    return Lobes(
        diffuse * share,
        specular * share,
        reflection * share,
        transmission * share,
        shininess,
        select(1.0 / ior, ior, point.is_front),
    );
}

// Transmittance of the medium that a ray crossed for a local distance before it hit the back.
fn transmittance(point: Point, distance: f32) -> vec3f {
    return exp(-material_color(point.material, ABSORPTION) * (distance * shading.view.inverse_scale));
}

// Fresnel reflectance of a dielectric for unpolarised light; 1 for total internal reflection.
fn fresnel(cosine: f32, ior: f32) -> f32 {
    let square = 1.0 - (1.0 - cosine * cosine) / (ior * ior);
    if !(square > 0.0) {
        return 1.0;
    }
    let behind = sqrt(square);
    let across = (cosine - ior * behind) / (cosine + ior * behind);
    let along = (ior * cosine - behind) / (ior * cosine + behind);
    return 0.5 * (across * across + along * along);
}

// The direction of the refracted ray (Snell's law), where fresnel() is below 1.
fn refracted(back: vec3f, normal: vec3f, ior: f32) -> vec3f {
    let cosine = dot(back, normal);
    let behind = sqrt(max(1.0 - (1.0 - cosine * cosine) / (ior * ior), 0.0));
    return normalize((cosine / ior - behind) * normal - back / ior);
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
