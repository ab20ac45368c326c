// Counts the requests in each chunk of 32 words of the bitmap.

struct Params {
    words: u32,
    chunks: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> requests: array<u32>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    let last = min(id.x * 32u + 32u, params.words);
    var count = 0u;
    for (var i = id.x * 32u; i < last; i++) {
        count += countOneBits(requests[i]);
    }
    counts[id.x] = count;
}
