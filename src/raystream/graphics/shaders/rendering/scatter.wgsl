// Sampling BSDFs: the direction of a path's next ray. As raystream/rendering/shading/scatter.py,
// without roughness.

//! include "rendering/bsdf.wgsl"
//! include "rendering/warp.wgsl"

// A sample: weight is BSDF times cosine over the density, FAR for mirrors and glass.
struct Bounce {
    direction: vec3f,
    weight: vec3f,
    pdf: f32,
    is_valid: bool,
}

// Probabilities of the lobes, and the Fresnel reflectance of the transmissive part.
struct Shares {
    diffuse: f32,
    specular: f32,
    mirror: f32,
    through: f32,
    clear: f32,
}

fn mean(color: vec3f) -> f32 {
    return (color.x + color.y + color.z) * (1.0 / 3.0);
}

fn shares_of(lobes: Lobes, back: vec3f, normal: vec3f) -> Shares {
    let diffuse = mean(lobes.diffuse);
    let specular = mean(lobes.specular);
    var mirror = mean(lobes.reflection);
    var through = mean(lobes.transmission);
    var clear = 0.0;
    if through > 0.0 && lobes.ior != 1.0 {
        clear = fresnel(min(dot(back, normal), 1.0), lobes.ior);
    }
    mirror += clear * through;
    through *= 1.0 - clear;
    let total = diffuse + specular + mirror + through;
    let factor = select(0.0, 1.0 / select(1.0, total, total > 0.0), total > 0.0);
    return Shares(diffuse * factor, specular * factor, mirror * factor, through * factor, clear);
}

// Densities over solid angle of the diffuse and the glossy lobe, see reflected().
fn lobe_pdfs(lobes: Lobes, point: Point, back: vec3f, toward: vec3f) -> vec2f {
    let cosine = dot(point.normal, toward);
    if !(cosine > 0.0 && dot(point.plane, toward) > 0.0) {
        return vec2f(0.0);
    }
    var glossy = 0.0;
    let along = dot(mirrored(back, point.normal), toward);
    if along > 0.0 && largest(lobes.specular) > 0.0 {
        glossy = pow(along, lobes.shininess) * INV_TWO_PI * (lobes.shininess + 1.0);
    }
    return vec2f(cosine * INV_PI, glossy);
}

// Density of scatter() for a direction.
fn reflection_pdf(lobes: Lobes, point: Point, back: vec3f, toward: vec3f) -> f32 {
    let shares = shares_of(lobes, back, point.normal);
    let pdfs = lobe_pdfs(lobes, point, back, toward);
    return shares.diffuse * pdfs.x + shares.specular * pdfs.y;
}

fn scatter(lobes: Lobes, point: Point, back: vec3f, choice: f32, numbers: vec2f) -> Bounce {
    let shares = shares_of(lobes, back, point.normal);
    let scattered = shares.diffuse + shares.specular;
    if choice < scattered {
        var toward: vec3f;
        if choice < shares.diffuse {
            toward = around(cosine_hemisphere(numbers), point.normal);
        } else {
            let mirror = mirrored(back, point.normal);
            toward = around(power_cosine(numbers, lobes.shininess), mirror);
        }
        let pdfs = lobe_pdfs(lobes, point, back, toward);
        let pdf = shares.diffuse * pdfs.x + shares.specular * pdfs.y;
        if !(pdf > 0.0) {
            return Bounce(toward, vec3f(0.0), 0.0, false);
        }
        return Bounce(toward, reflected(lobes, point, back, toward) / pdf, pdf, true);
    }
    if choice < scattered + shares.mirror {
        let toward = mirrored(back, point.normal);
        let light = lobes.reflection + shares.clear * lobes.transmission;
        let is_outside = dot(point.plane, toward) > 0.0;
        return Bounce(toward, light / shares.mirror, FAR, is_outside);
    }
    if !(shares.through > 0.0) {
        return Bounce(point.normal, vec3f(0.0), 0.0, false);
    }
    let toward = refracted(back, point.normal, lobes.ior);
    // Refraction changes solid angles.
    let share = shares.through * lobes.ior * lobes.ior / (1.0 - shares.clear);
    let is_inside = dot(point.plane, toward) < 0.0;
    return Bounce(toward, lobes.transmission / share, FAR, is_inside);
}
