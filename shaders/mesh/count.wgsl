// Counts each block's marked edges, in all and before each group of eight words.
import package::shared::edges::{EDGE_WORDS, EDGE_GROUPS, EDGE_STRIDE};

struct Params {
    blocks: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> edges: array<u32>;
@group(0) @binding(2) var<storage, read_write> vertex_counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var block = id.x; block < params.blocks; block += groups.x * 64u) {
        let base = block * EDGE_STRIDE;
        var count = 0u;
        for (var group = 0u; group < EDGE_GROUPS; group++) {
            edges[base + EDGE_WORDS + group] = count;
            for (var i = 0u; i < 8u; i++) {
                count += countOneBits(edges[base + group * 8u + i]);
            }
        }
        vertex_counts[block] = count;
    }
}
