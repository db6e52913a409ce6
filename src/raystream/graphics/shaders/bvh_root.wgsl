// Where the search of a tree begins and ends: at the root, and with an empty stack. In scenes with
// instances, which have many trees, instances/bvh_root.wgsl replaces this file.

struct Tree {
    // 0 in an empty tree.
    node_count: u32,
}

// Push the root, if the tree is not empty.
fn begin_search(ray: Ray) {
    stack_top = 0u;
    if params.tree.node_count != 0u && ray.t_min <= ray.t_max {
        push(Entry(0u, ROOT));
    }
}

fn has_entries() -> bool {
    return stack_top != 0u;
}

fn search(ray: Ray) {
    search_tree(ray);
}
