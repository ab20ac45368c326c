// Finds the 27 blocks around each block of a range (index plus one, or zero), itself among them; all zero for a block
// that is not in use.
import package::shared::map::{Map, NO_KEY, pack_key, unpack_position};
import package::shared::table::{keys, find_in_hash};

struct Params {
    map: Map,
    first: u32,
    count: u32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> neighbours: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * 27u; i += groups.x * 64u) {
        let key = keys[params.first + i / 27u];
        let n = i % 27u;
        let offset = vec3<i32>(vec3(n % 3u, (n / 3u) % 3u, n / 9u)) - vec3(1);
        var found = 0u;
        if any(key != NO_KEY) {
            found = find_in_hash(params.map, pack_key(unpack_position(key) + offset, key.y >> 16u));
        }
        neighbours[i] = found;
    }
}
