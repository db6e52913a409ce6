// A ray's stack of children, in private memory, of STACK_SIZE entries.

struct Entry {
    // The child's key; see bvh_boxes.wgsl.
    key: u32,
    link: i32,
}

var<private> stack_keys: array<u32, STACK_SIZE>;
var<private> stack_links: array<i32, STACK_SIZE>;
var<private> stack_top: u32;

fn push(entry: Entry) {
    stack_keys[stack_top] = entry.key;
    stack_links[stack_top] = entry.link;
    stack_top += 1u;
}

fn pop() -> Entry {
    stack_top -= 1u;
    return Entry(stack_keys[stack_top], stack_links[stack_top]);
}
