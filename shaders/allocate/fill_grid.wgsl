// Enters every block of the submap that lies within the grid's reach into the grid (which is cleared before).
import package::shared::map::{Map, BLOCKS, OUTSIDE, cell_of, unpack_position};

struct Params {
    map: Map,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read_write> cells: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var block = id.x; block < counters[BLOCKS]; block += groups.x * 64u) {
        let key = keys[block];
        if (key.y >> 16u) == params.map.submap {
            let cell = cell_of(params.map, unpack_position(key));
            if cell != OUTSIDE {
                cells[cell] = block + 1u;
            }
        }
    }
}
