// Takes down, for a range of blocks, the signs of their voxels and of their neighbours' nearest layer, out of one page.
// Run once a page, page 0 first.
import package::shared::map::{BLOCK_VOXELS, index_in_block};
import package::shared::padded::neighbour_index;
import package::shared::signs::{SIGN_SIDE, SIGN_ROWS};
import package::shared::distance::{Voxel, sign_bit, unpack_weight};

struct Params {
    count: u32,
    page: u32,
    page_shift: u32,
    min_weight: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> neighbours: array<u32>;
@group(0) @binding(2) var<storage, read> voxels: array<Voxel>;
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
        let at = index_in_block(vec3(0, y, z));
        let n = block * 27u + neighbour_index(vec3(0, y >> 3u, z >> 3u));
        row |= sign_bits(neighbours[n - 1u], at + 7u, 1u);
        row |= sign_bits(neighbours[n], at, 8u) << 1u;
        row |= sign_bits(neighbours[n + 1u], at, 1u) << 9u;
        signs[i] = row;
    }
}

// The bits of `count` voxels of a block (index plus one) from the one at `at` on; none where it lies in another page or
// nowhere.
fn sign_bits(source: u32, at: u32, count: u32) -> u32 {
    if source == 0u || ((source - 1u) >> params.page_shift) != params.page {
        return 0u;
    }
    let first = ((source - 1u) & ((1u << params.page_shift) - 1u)) * BLOCK_VOXELS + at;
    var bits = 0u;
    for (var x = 0u; x < count; x++) {
        let voxel = voxels[first + x];
        let seen = u32(unpack_weight(voxel) >= params.min_weight);
        bits |= (sign_bit(voxel) | (seen << 16u)) << x;
    }
    return bits;
}
