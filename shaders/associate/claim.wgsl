// Where in the list each pixel's surfel is; and of those that competed with it and are as well known, which one is to be merged with
// it: the first of several.
import package::shared::surfel::{SEEN, IN_FRONT};

struct Params {
    room: u32,
    stable: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> centres: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> targets: array<u32>;
@group(0) @binding(5) var<storage, read> chosen: array<u32>;
// Of a pixel with a surfel; of others nothing is known.
@group(0) @binding(6) var<storage, read_write> slots: array<u32>;
// The complement of the index of the surfel that is to be merged; zeroed memory has none.
@group(0) @binding(7) var<storage, read_write> rivals: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let goal = targets[i];
        if goal == 0u || (goal & IN_FRONT) != 0u {
            continue;
        }
        if chosen[goal - 1u] == ~listed[i] {
            slots[goal - 1u] = i;
        } else if centres[i].w >= params.stable {
            atomicMax(&rivals[goal - 1u], ~listed[i]);
        }
    }
}
