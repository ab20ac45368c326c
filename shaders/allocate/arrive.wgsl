// Asks for those of the arriving blocks that the map does not hold: requests like those of the frame's depth.
import package::shared::map::{Map, OUTSIDE, cell_of, unpack_position};

struct Params {
    map: Map,
    count: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> arriving: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> cells: array<u32>;
@group(0) @binding(3) var<storage, read_write> requests: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count; i += groups.x * 64u) {
        let cell = cell_of(params.map, unpack_position(arriving[i]));
        if cell != OUTSIDE && cells[cell] == 0u {
            atomicOr(&requests[cell >> 5u], 1u << (cell & 31u));
        }
    }
}
