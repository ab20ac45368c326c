// Lists the first so many of the marked blocks, with their keys, in the order of their indices.

struct Params {
    chunks: u32,
    // Blocks that the list can hold.
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> bits: array<u32>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> listed: array<u32>;
@group(0) @binding(5) var<storage, read_write> listed_keys: array<vec2<u32>>;
// How many are marked; becomes how many are listed.
@group(0) @binding(6) var<storage, read_write> count: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    var mask = bits[id.x];
    var at = offsets[id.x];
    while mask != 0u && at < params.room {
        let block = id.x * 32u + firstTrailingBit(mask);
        listed[at] = block;
        listed_keys[at] = keys[block];
        mask &= mask - 1u;
        at += 1u;
    }
    // The last chunk alone knows the whole number.
    if id.x == params.chunks - 1u {
        count[0] = min(offsets[id.x] + countOneBits(bits[id.x]), params.room);
    }
}
