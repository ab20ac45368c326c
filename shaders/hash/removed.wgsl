// Brings the counters up to date after removal.
import package::shared::map::{FREE_BLOCKS, TOMBSTONES};

struct Params {
    count: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<u32>;

@compute @workgroup_size(1)
fn main() {
    counters[FREE_BLOCKS] += params.count;
    counters[TOMBSTONES] += params.count;
}
