// Tests blocks against the view's frustum: 32 blocks an invocation, one bit each, and how many of the bits are set.
import package::shared::frustum::{Frustum, is_within};
import package::shared::map::{Map, BLOCKS};

struct Params {
    frustum: Frustum,
    map: Map,
    chunks: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read_write> bits: array<u32>;
@group(0) @binding(4) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    let first = id.x * 32u;
    let last = min(first + 32u, counters[BLOCKS]);
    var mask = 0u;
    for (var block = first; block < last; block++) {
        if is_within(params.map, params.frustum, keys[block]) {
            mask |= 1u << (block & 31u);
        }
    }
    bits[id.x] = mask;
    counts[id.x] = countOneBits(mask);
}
