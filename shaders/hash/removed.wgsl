// Brings the counters up to date after removal.
import package::shared::map::{FREE_BLOCKS, TOMBSTONES};

@group(0) @binding(1) var<storage, read_write> counters: array<u32>;
@group(0) @binding(2) var<storage, read> count: array<u32>;

@compute @workgroup_size(1)
fn main() {
    counters[FREE_BLOCKS] += count[0];
    counters[TOMBSTONES] += count[0];
}
