// Parents in a tree of nodes of 8 bytes: the row of a split is half that of its left child.

// Two vectors each; see backtrack.wgsl. The link is the split's own node.
@group(1) @binding(2) var<storage, read> extended: array<vec4u>;

fn parent_row(node: u32) -> u32 {
    return (node - 1u) / 2u;
}

fn node_of_row(row: u32, link: u32) -> u32 {
    return link;
}
