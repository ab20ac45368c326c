// Looking blocks up in the grid around the view. It covers the whole view with a margin, so that what lies outside of it
// cannot be seen.
import package::shared::map::{Map, OUTSIDE, cell_of};

@group(1) @binding(2) var<storage, read> grid: array<u32>;

// A block's index plus one, or zero.
fn find_in_grid(map: Map, block: vec3<i32>) -> u32 {
    let cell = cell_of(map, block);
    // Without a branch: the first cell is read in vain.
    return select(grid[select(cell, 0u, cell == OUTSIDE)], 0u, cell == OUTSIDE);
}
