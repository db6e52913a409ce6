// Parents in Foley's layout: splits and leaves point to them.

// Two vectors each, in the order of the splits; see backtrack.wgsl. The link is the parent.
@group(1) @binding(3) var<storage, read> extended: array<vec4u>;

fn parent_row(node: u32) -> u32 {
    if is_leaf(node) {
        return leaves[3u * (node & ROW_BITS) + 2u];
    }
    return extended[2u * node + 1u].z;
}

fn node_of_row(row: u32, link: u32) -> u32 {
    return row;
}
