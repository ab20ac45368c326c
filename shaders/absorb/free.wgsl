// Lists the slots of one page that hold no surfel, in their order. Lists of earlier frames are forgotten.
import package::shared::surfel::{USED, TAKEN};

struct Params {
    first: u32,
    page: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<u32>;
@group(0) @binding(2) var<storage, read> places: array<vec4<f32>>;
// How many come before each 32 slots.
@group(0) @binding(3) var<storage, read> dead: array<u32>;
@group(0) @binding(4) var<storage, read_write> free: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(params.page, counters[USED] - min(params.first, counters[USED]));
    for (var chunk = id.x; chunk * 32u < count; chunk += groups.x * 64u) {
        var at = dead[params.first / 32u + chunk];
        let last = min(chunk * 32u + 32u, count);
        for (var i = chunk * 32u; i < last; i++) {
            if places[i].w == 0.0 {
                free[at] = params.first + i;
                at += 1u;
            }
        }
    }
    if id.x == 0u {
        counters[TAKEN] = 0u;
    }
}
