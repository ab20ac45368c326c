// Takes blocks out of the hash and puts them on the free list, in the order given. Their voxels are cleared by
// `hash/clear`.
import package::shared::map::{Map, NO_KEY, FREE_BLOCKS};
import package::shared::insert::remove_from_hash;

struct Params {
    map: Map,
}

@group(0) @binding(0) var<uniform> params: Params;
// Blocks that are in use, each once.
@group(0) @binding(1) var<storage, read> blocks: array<u32>;
@group(0) @binding(2) var<storage, read> counters: array<u32>;
@group(0) @binding(3) var<storage, read_write> keys: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> free_blocks: array<u32>;
@group(0) @binding(5) var<storage, read> count: array<u32>;
@group(0) @binding(6) var<storage, read_write> last_seen: array<u32>;
@group(0) @binding(7) var<storage, read_write> last_changed: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < count[0]; i += groups.x * 64u) {
        let block = blocks[i];
        remove_from_hash(params.map, keys[block], block);
        keys[block] = NO_KEY;
        last_seen[block] = 0u;
        last_changed[block] = 0u;
        free_blocks[counters[FREE_BLOCKS] + i] = block;
    }
}
