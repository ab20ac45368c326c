// Enters every block in use into a cleared hash: after the pools have grown, or when tombstones have piled up.
import package::shared::map::{Map, NO_KEY, BLOCKS};
import package::shared::insert::insert_into_hash;

struct Params {
    map: Map,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var block = id.x; block < counters[BLOCKS]; block += groups.x * 64u) {
        let key = keys[block];
        if any(key != NO_KEY) {
            insert_into_hash(params.map, key, block);
        }
    }
}
