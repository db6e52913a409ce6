// All rows of the list of triangles. In scenes with instances, instances/brute_rows.wgsl replaces this file.

struct Tree {
    triangle_count: u32,
}

fn search(ray: Ray) {
    test_rows(ray, 0u, params.tree.triangle_count);
}
