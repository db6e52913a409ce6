// The nearest hits of a ray: a heap with the farthest one at its root, sorted at the end. As
// raystream/kernels/hits.py. A ray's rows are its own, so no other invocation touches them.

fn row_before(a: Row, b: Row) -> bool {
    return is_before(a.t, a.prim_id, b.t, b.prim_id);
}

// Insert a hit into a heap of `count` rows, from an empty place downward.
fn sift_down(count: u32, empty: u32, row: Row) {
    var hole = empty;
    while 2u * hole + 1u < count {
        var child = 2u * hole + 1u;
        if child + 1u < count && row_before(rows[found.first + child], rows[found.first + child + 1u]) {
            child += 1u;
        }
        if !row_before(row, rows[found.first + child]) {
            break;
        }
        rows[found.first + hole] = rows[found.first + child];
        hole = child;
    }
    rows[found.first + hole] = row;
}

fn make_heap(count: u32) {
    var hole = count / 2u;
    while hole != 0u {
        hole -= 1u;
        sift_down(count, hole, rows[found.first + hole]);
    }
}

// Rows are unordered until there are `capacity` of them.
fn keep(row: Row) {
    if found.capacity == 0u {
        return;
    }
    if found.count == found.capacity {
        if row_before(row, rows[found.first]) {
            sift_down(found.count, 0u, row);
        }
        found.t_far = rows[found.first].t;
        return;
    }
    rows[found.first + found.count] = row;
    found.count += 1u;
    if found.count == found.capacity {
        make_heap(found.count);
        found.t_far = rows[found.first].t;
    }
}

// Sort by t, then prim_id.
fn sort_rows() {
    make_heap(found.count);
    var last = found.count;
    while last > 1u {
        last -= 1u;
        let row = rows[found.first + last];
        rows[found.first + last] = rows[found.first];
        sift_down(last, 0u, row);
    }
}
