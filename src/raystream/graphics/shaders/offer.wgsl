// What structures do with a hit that they find. In scenes with instances, instances/offer.wgsl
// replaces this file.

// Offer a hit: with t <= t_far, and once for each triangle.
fn offer(hit: Hit, prim_id: i32) {
    take(hit, prim_id);
}
