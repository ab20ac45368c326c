// Pixels that see through a surfel that was seen more than once (stable ones that have fallen count, so that what comes into view of an
// object later falls too): it stands well in front of what they measure.
import package::shared::surfel::{SEEN, IN_FRONT, KNOWN, pixel_of};

struct Params {
    room: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> targets: array<vec2<u32>>;
// 1 at such a pixel.
@group(0) @binding(3) var<storage, read_write> vacant: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let goal = targets[i].x;
        if (goal & IN_FRONT) != 0u && (goal & KNOWN) != 0u {
            atomicStore(&vacant[pixel_of(goal)], 1u);
        }
    }
}
