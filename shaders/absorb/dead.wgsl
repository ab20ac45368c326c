// How many of each 32 slots of one page hold no surfel.
import package::shared::surfel::USED;

struct Params {
    first: u32,
    page: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> places: array<vec4<f32>>;
// Of all pages' slots.
@group(0) @binding(3) var<storage, read_write> dead: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(params.page, counters[USED] - min(params.first, counters[USED]));
    for (var chunk = id.x; chunk * 32u < params.page; chunk += groups.x * 64u) {
        let last = min(chunk * 32u + 32u, count);
        var sum = 0u;
        for (var i = chunk * 32u; i < last; i++) {
            sum += u32(places[i].w == 0.0);
        }
        dead[params.first / 32u + chunk] = sum;
    }
}
