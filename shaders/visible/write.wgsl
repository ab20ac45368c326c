// Writes the visible list, in the order of block indices.

struct Params {
    chunks: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> bits: array<u32>;
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read_write> visible: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    var mask = bits[id.x];
    var at = offsets[id.x];
    while mask != 0u {
        visible[at] = id.x * 32u + firstTrailingBit(mask);
        mask &= mask - 1u;
        at += 1u;
    }
}
