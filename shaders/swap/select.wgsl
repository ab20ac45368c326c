// Marks the blocks that are to leave: those that no view has reached for so many frames, 32 an invocation, one bit each, and
// how many of the bits are set.
import package::shared::map::{NO_KEY, BLOCKS};

struct Params {
    frame: u32,
    // Ages from here on leave.
    least_age: u32,
    chunks: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> last_seen: array<u32>;
@group(0) @binding(4) var<storage, read_write> bits: array<u32>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    let first = id.x * 32u;
    let last = min(first + 32u, counters[BLOCKS]);
    var mask = 0u;
    for (var block = first; block < last; block++) {
        if any(keys[block] != NO_KEY) && last_seen[block] != 0u && params.frame - last_seen[block] >= params.least_age {
            mask |= 1u << (block & 31u);
        }
    }
    bits[id.x] = mask;
    counts[id.x] = countOneBits(mask);
}
