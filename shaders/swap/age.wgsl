// Notes which blocks the view reaches, with its margin, and counts the others by how many frames ago it last did.
import package::shared::ages::{AGE_BINS, age_bin};
import package::shared::frustum::{Frustum, is_within};
import package::shared::map::{Map, NO_KEY, BLOCKS};

struct Params {
    frustum: Frustum,
    map: Map,
    // Number of this frame, from 1.
    frame: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;
// Of each block the last frame whose view reached it; 0 for a block that is new.
@group(0) @binding(3) var<storage, read_write> last_seen: array<u32>;
@group(0) @binding(4) var<storage, read_write> ages: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var block = id.x; block < counters[BLOCKS]; block += groups.x * 64u) {
        let key = keys[block];
        if all(key == NO_KEY) {
            continue;
        }
        let seen = last_seen[block];
        if seen == 0u || is_within(params.map, params.frustum, key) {
            last_seen[block] = params.frame;
        } else if seen != params.frame {
            // (Another submap's view of the same frame may have reached it.)
            atomicAdd(&ages[age_bin(params.frame - seen)], 1u);
        }
    }
}
