// Asks again for the blocks that found no room in earlier frames: those that the grid covers become requests like any
// other, the rest keep waiting. One invocation: the list is empty but for the frames after a pool was full.
import package::shared::map::{Map, PENDING, OUTSIDE, cell_of, unpack_position};

struct Params {
    map: Map,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<u32>;
@group(0) @binding(2) var<storage, read_write> pending: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> cells: array<u32>;
@group(0) @binding(4) var<storage, read_write> requests: array<u32>;

@compute @workgroup_size(1)
fn main() {
    var kept = 0u;
    for (var i = 0u; i < counters[PENDING]; i++) {
        let key = pending[i];
        let cell = cell_of(params.map, unpack_position(key));
        if cell == OUTSIDE || (key.y >> 16u) != params.map.submap {
            pending[kept] = key;
            kept += 1u;
        } else if cells[cell] == 0u {
            requests[cell >> 5u] |= 1u << (cell & 31u);
        }
    }
    counters[PENDING] = kept;
}
