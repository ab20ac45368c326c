// Looks keys up in the hash: a block's index plus one, or zero.
import package::shared::map::Map;
import package::shared::table::find_in_hash;

struct Params {
    map: Map,
    count: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> wanted: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read_write> found: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count; i += groups.x * 64u) {
        found[i] = find_in_hash(params.map, wanted[i]);
    }
}
