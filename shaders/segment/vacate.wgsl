// Pixels that see through a surfel that was seen more than once: it stands well in front of what they measure.
import package::shared::surfel::{SEEN, IN_FRONT};

struct Params {
    room: u32,
    // Of a surfel's confidence: stable ones that have fallen count, so that what comes into view of an object later falls too.
    least: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> centres: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> targets: array<u32>;
// 1 at such a pixel.
@group(0) @binding(4) var<storage, read_write> vacant: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        if (targets[i] & IN_FRONT) != 0u && centres[i].w >= params.least {
            atomicStore(&vacant[(targets[i] & ~IN_FRONT) - 1u], 1u);
        }
    }
}
