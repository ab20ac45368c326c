// The signs of a block's voxels and of one layer around them, a row along x in one word: bit x + 1 is set where the
// distance is negative, bit x + 17 where the voxel was seen. All cells of a row are then told apart at once.

const SIGN_SIDE: i32 = 10;
const SIGN_ROWS: u32 = 100u;

@group(0) @binding(1) var<storage, read> signs: array<u32>;

// The row at y and z, -1 to 8 each.
fn sign_row(block: u32, y: i32, z: i32) -> u32 {
    return signs[block * SIGN_ROWS + u32(y + 1 + SIGN_SIDE * (z + 1))];
}

// The four rows that bound the cells at y and z: (y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1).
fn cell_rows(block: u32, y: i32, z: i32) -> vec4<u32> {
    return vec4(
        sign_row(block, y, z),
        sign_row(block, y + 1, z),
        sign_row(block, y, z + 1),
        sign_row(block, y + 1, z + 1),
    );
}

// Bit x + 1 for each cell, x from -1 to 7, whose eight corners were all seen.
fn seen_cells(rows: vec4<u32>) -> u32 {
    let corners = (rows.x & rows.y & rows.z & rows.w) >> 16u;
    return corners & (corners >> 1u);
}

// Bit x for each cell, x from 0 to 7, that was seen whole and has corners of both signs.
fn surface_cells(rows: vec4<u32>) -> u32 {
    let some = rows.x | rows.y | rows.z | rows.w;
    let all_of = rows.x & rows.y & rows.z & rows.w;
    let crossed = (some | (some >> 1u)) & ~(all_of & (all_of >> 1u));
    return ((crossed & seen_cells(rows)) >> 1u) & 0xffu;
}

// A cell's case: bit c for a negative corner c, which lies at (c & 1, (c >> 1) & 1, c >> 2).
fn cell_case(rows: vec4<u32>, x: u32) -> u32 {
    let pairs = (rows >> vec4(x + 1u)) & vec4(3u);
    return pairs.x | (pairs.y << 2u) | (pairs.z << 4u) | (pairs.w << 6u);
}
