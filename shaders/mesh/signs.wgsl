// Takes down, for a range of blocks, the signs of their voxels and of their neighbours' nearest layer, out of one page.
// Run once a page, page 0 first.
import package::shared::map::{BLOCK_VOXELS, index_in_block};
import package::shared::padded::neighbour_index;
import package::shared::signs::{SIGN_SIDE, SIGN_ROWS};
import package::shared::distance::unpack_weight;

struct Params {
    count: u32,
    page: u32,
    page_shift: u32,
    min_weight: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> neighbours: array<u32>;
@group(0) @binding(2) var<storage, read> voxels: array<u32>;
@group(0) @binding(3) var<storage, read_write> signs: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * SIGN_ROWS; i += groups.x * 64u) {
        let block = i / SIGN_ROWS;
        let y = i32(i % SIGN_ROWS) % SIGN_SIDE - 1;
        let z = i32(i % SIGN_ROWS) / SIGN_SIDE - 1;
        // What the pages before this one held.
        var row = 0u;
        if params.page > 0u {
            row = signs[i];
        }
        row |= sign_bits(block, vec3(-1, y, z));
        for (var x = 0; x < 8; x++) {
            row |= sign_bits(block, vec3(x, y, z));
        }
        row |= sign_bits(block, vec3(8, y, z));
        signs[i] = row;
    }
}

// A voxel's bits of its row; none where it lies in another page or nowhere.
fn sign_bits(block: u32, voxel: vec3<i32>) -> u32 {
    let source = neighbours[block * 27u + neighbour_index(voxel >> vec3(3u))];
    if source == 0u || ((source - 1u) >> params.page_shift) != params.page {
        return 0u;
    }
    let in_page = (source - 1u) & ((1u << params.page_shift) - 1u);
    let word = voxels[in_page * BLOCK_VOXELS + index_in_block(voxel)];
    // The upper half of the fixed-point numbers are the negative distances.
    let negative = (word >> 15u) & 1u;
    let seen = u32(unpack_weight(word) >= params.min_weight);
    return (negative | (seen << 16u)) << u32(voxel.x + 1);
}
