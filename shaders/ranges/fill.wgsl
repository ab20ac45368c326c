// Draws the fragments into the range image: a pixel's nearest and farthest depth over all blocks that cover it. The
// nearest is kept as the complement of its bits, so that zeroed memory is an empty image.
import package::shared::map::FRAGMENTS;

struct Params {
    range_size: vec2<u32>,
    // Entries in `offsets`.
    blocks: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> boxes: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> offsets: array<u32>;
@group(0) @binding(4) var<storage, read_write> ranges: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var fragment = id.x; fragment < counters[FRAGMENTS]; fragment += groups.x * 64u) {
        // The last block whose first fragment is not behind this one.
        var low = 0u;
        var high = params.blocks;
        while low + 1u < high {
            let middle = (low + high) / 2u;
            if offsets[middle] <= fragment {
                low = middle;
            } else {
                high = middle;
            }
        }
        let box = boxes[low];
        let a = vec2(box.x & 0xffffu, box.x >> 16u);
        let b = vec2(box.y & 0xffffu, box.y >> 16u);
        let per_row = (b.x - a.x) / 16u + 1u;
        let rank = fragment - offsets[low];
        let first = a + 16u * vec2(rank % per_row, rank / per_row);
        let last = min(first + vec2(15u), b);
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let at = 2u * (y * params.range_size.x + x);
                atomicMax(&ranges[at], ~box.z);
                atomicMax(&ranges[at + 1u], box.w);
            }
        }
    }
}
