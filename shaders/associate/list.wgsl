// Lists the surfels in view, in the order of their slots. Where they are is worked out anew by each pass over the list: on software
// drivers that takes less than writing it down.

struct Params {
    slots: u32,
    // The list's room.
    room: u32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
// How many come before each 32 slots, and behind those the slots' bits.
@group(0) @binding(1) var<storage, read> seen: array<u32>;
@group(0) @binding(2) var<storage, read_write> listed: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let chunks = params.slots / 32u;
    for (var chunk = id.x; chunk < chunks; chunk += groups.x * 64u) {
        var at = seen[chunk];
        var bits = seen[chunks + chunk];
        while bits != 0u && at < params.room {
            listed[at] = chunk * 32u + firstTrailingBit(bits);
            bits &= bits - 1u;
            at += 1u;
        }
    }
}
