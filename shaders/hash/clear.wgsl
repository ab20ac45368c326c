// Zeroes one plane's voxels of those of the given blocks that lie in one page.

struct Params {
    page: u32,
    page_shift: u32,
    unused: u32,
    // Words of a block in this plane.
    block_words: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> blocks: array<u32>;
@group(0) @binding(2) var<storage, read_write> voxels: array<u32>;
@group(0) @binding(3) var<storage, read> count: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    for (var i = group.x; i < count[0]; i += groups.x) {
        let block = blocks[i];
        if (block >> params.page_shift) == params.page {
            let first = (block & ((1u << params.page_shift) - 1u)) * params.block_words;
            for (var voxel = lane; voxel < params.block_words; voxel += 64u) {
                voxels[first + voxel] = 0u;
            }
        }
    }
}
