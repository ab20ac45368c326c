// Puts the chosen points into the image, and lists the pixels that got none. The list's order is of no consequence: each of
// them is cast by itself.
import package::shared::pixels::{COUNT, FIRST};

struct Params {
    pixels: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> before: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> chosen: array<u32>;
@group(0) @binding(3) var<storage, read_write> points: array<vec4<f32>>;
// Workgroups of 64 as an indirect dispatch takes them, the number of pixels, and those.
@group(0) @binding(4) var<storage, read_write> missing: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.pixels; i += groups.x * 64u) {
        if chosen[i] != 0u {
            points[i] = before[~chosen[i]];
        } else {
            points[i] = vec4(0.0);
            let place = atomicAdd(&missing[COUNT], 1u);
            atomicStore(&missing[FIRST + place], i);
            atomicMax(&missing[0], min(place / 64u + 1u, 65535u));
        }
    }
}
