// A pixel with one path at a time has its row in the textures of its record. Behind glass,
// path_rows.wgsl replaces this file.

const BRANCHES: u32 = 1u;

fn row_at(half: u32, k: u32) -> Path {
    return current;
}

fn put_row() {}

fn has_room() -> bool {
    return true;
}

fn count_onward() {}
