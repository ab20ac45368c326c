// Takes over what `insert` and `extend` did into the counters.
import package::shared::surfel::{USED, FREE, TAKEN, SEEN, NEW, DROPPED};

struct Params {
    capacity: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<u32>;

@compute @workgroup_size(1)
fn main() {
    let in_free = min(counters[NEW], counters[FREE] - counters[TAKEN]);
    let behind = counters[NEW] - in_free;
    let placed = min(behind, params.capacity - counters[USED]);
    counters[TAKEN] += in_free;
    counters[USED] += placed;
    counters[SEEN] += in_free + placed;
    counters[DROPPED] = behind - placed;
}
