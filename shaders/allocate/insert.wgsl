// Gives each request a block: its rank among all requests decides which, so that the numbering never depends on who
// comes first. What finds no room goes to the pending list, in the same order.
import package::shared::map::{Map, NO_KEY, BLOCKS, FREE_BLOCKS, PENDING, pack_key, block_of_cell};
import package::shared::insert::insert_into_hash;

struct Params {
    map: Map,
    words: u32,
    chunks: u32,
    pending_capacity: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> requests: array<u32>;
@group(0) @binding(3) var<storage, read> offsets: array<u32>;
@group(0) @binding(4) var<storage, read> free_blocks: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read_write> cells: array<u32>;
@group(0) @binding(7) var<storage, read_write> pending: array<vec2<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    let free = counters[FREE_BLOCKS];
    let room = free + params.map.capacity - counters[BLOCKS];
    var rank = offsets[id.x];
    let last = min(id.x * 32u + 32u, params.words);
    for (var word = id.x * 32u; word < last; word++) {
        var bits = requests[word];
        while bits != 0u {
            let cell = word * 32u + firstTrailingBit(bits);
            bits &= bits - 1u;
            let key = pack_key(block_of_cell(params.map, cell), params.map.submap);
            if rank < room {
                var block = counters[BLOCKS] + rank - free;
                if rank < free {
                    block = free_blocks[free - 1u - rank];
                }
                keys[block] = key;
                cells[cell] = block + 1u;
                insert_into_hash(params.map, key, block);
            } else {
                let at = counters[PENDING] + rank - room;
                if at < params.pending_capacity {
                    pending[at] = key;
                }
            }
            rank += 1u;
        }
    }
}
