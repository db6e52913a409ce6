// The first sector of a ray: found from a sector near it, that of its bin.

// The bin of a ray at t, up to rounding.
fn bin_row(ray: Ray, t: f32) -> u32 {
    let origin = from_frame(ray.kz, ray.origin);
    let position = fused3(vec3f(t), from_frame(ray.kz, ray.direction), origin);
    let place = (position - params.tree.bin_low) * params.tree.bin_scales;
    let counts = params.tree.bin_counts;
    let bin = vec3u(clamp(place, vec3f(0.0), counts - vec3f(1.0)));
    return (bin.x * u32(counts.y) + bin.y) * u32(counts.z) + bin.z;
}

// Walk from any sector to the one that holds a ray at t: first back, through entry faces, until all
// are before t; then forward, through exit faces, until none is. Exact from any start.
fn walk_to(line: PlaneRay, near: u32, t: f32) -> u32 {
    var sector = near;
    var way = way_back(line, sector);
    while way.t > t && spend_budget() {
        sector = cross_face(line, way.link, t).sector;
        way = way_back(line, sector);
    }
    way = way_out(line, sector);
    while way.t <= t && spend_budget() {
        sector = cross_face(line, way.link, t).sector;
        way = way_out(line, sector);
    }
    return sector;
}

fn start_sector(line: PlaneRay, ray: Ray, t: f32) -> u32 {
    return walk_to(line, bins[bin_row(ray, t)], t);
}
