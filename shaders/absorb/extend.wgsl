// Lists the new surfels behind those in view, in their order, so that the frame's pose can be looked from without another list.
import package::shared::surfel::{USED, FREE, TAKEN, SEEN};

struct Params {
    capacity: u32,
    chunks: u32,
    // The list's room.
    room: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
// How many come before each 32 pixels, and behind those the pixels' bits.
@group(0) @binding(2) var<storage, read> wanted: array<u32>;
@group(0) @binding(3) var<storage, read> free: array<u32>;
@group(0) @binding(4) var<storage, read_write> listed: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let taken = counters[TAKEN];
    let available = counters[FREE] - taken;
    let used = counters[USED];
    let seen = counters[SEEN];
    for (var chunk = id.x; chunk < params.chunks; chunk += groups.x * 64u) {
        let first = wanted[chunk];
        let count = countOneBits(wanted[params.chunks + chunk]);
        for (var rank = first; rank < first + count; rank++) {
            // As `insert` places them; what has no room comes last.
            var index = used + rank - available;
            if rank < available {
                index = free[taken + rank];
            }
            if index < params.capacity && seen + rank < params.room {
                listed[seen + rank] = index;
            }
        }
    }
}
