// Copies one plane's voxels of those of the listed blocks that lie in one page into the transfer buffer, where each block's
// planes lie one after the other.

struct Params {
    page: u32,
    page_shift: u32,
    // Words of a block in this plane, where they start within a transferred block, and how many that has.
    plane_words: u32,
    plane_start: u32,
    block_words: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> listed: array<u32>;
@group(0) @binding(2) var<storage, read> count: array<u32>;
@group(0) @binding(3) var<storage, read> plane: array<u32>;
@group(0) @binding(4) var<storage, read_write> transfer: array<u32>;

@compute @workgroup_size(64)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    for (var i = group.x; i < count[0]; i += groups.x) {
        let block = listed[i];
        if (block >> params.page_shift) == params.page {
            let source = (block & ((1u << params.page_shift) - 1u)) * params.plane_words;
            let out = i * params.block_words + params.plane_start;
            for (var word = lane; word < params.plane_words; word += 64u) {
                transfer[out + word] = plane[source + word];
            }
        }
    }
}
