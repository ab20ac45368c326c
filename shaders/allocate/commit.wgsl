// Brings the counters up to date after insertion.
import package::shared::map::{BLOCKS, FREE_BLOCKS, REQUESTED, ALLOCATED, PENDING, DROPPED};

struct Params {
    capacity: u32,
    pending_capacity: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<u32>;

@compute @workgroup_size(1)
fn main() {
    let requested = counters[REQUESTED];
    let free = counters[FREE_BLOCKS];
    let allocated = min(requested, free + params.capacity - counters[BLOCKS]);
    let reused = min(allocated, free);
    counters[ALLOCATED] = allocated;
    counters[FREE_BLOCKS] = free - reused;
    counters[BLOCKS] += allocated - reused;
    let waiting = counters[PENDING] + requested - allocated;
    counters[PENDING] = min(waiting, params.pending_capacity);
    counters[DROPPED] = waiting - counters[PENDING];
}
