// Stable surfels of one page become unstable where what they belong to moves, or where they are seen through: they vanish unless they
// are observed again (Keller et al. 2013, section on dynamics).
import package::shared::cells::{DYNAMIC, VACANT};
import package::shared::surfel::{SEEN, DEMOTED, IN_FRONT, depth_deviation};

struct Params {
    // Pixels to a row, cells to a row, pixels to a cell's side.
    width: u32,
    cells: u32,
    side: u32,
    room: u32,
    first: u32,
    page: u32,
    stable: f32,
    // What confidence is left to them.
    fallen: f32,
    // A surfel belongs to what its cell shows up to this difference in depth: metres, and standard deviations more.
    window_m: f32,
    window_deviations: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> centres: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> targets: array<u32>;
@group(0) @binding(5) var<storage, read> shown: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> marks: array<u32>;
@group(0) @binding(7) var<storage, read_write> places: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&counters[SEEN]), params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let goal = targets[i];
        let index = listed[i];
        if goal == 0u || index < params.first || index - params.first >= params.page {
            continue;
        }
        let pixel = (goal & ~IN_FRONT) - 1u;
        let cell = pixel / params.width / params.side * params.cells + pixel % params.width / params.side;
        // It was removed where this is 0.
        let confidence = places[index - params.first].w;
        var falls = (marks[cell] & VACANT) != 0u && confidence >= params.stable;
        if (goal & IN_FRONT) == 0u {
            let z = centres[i].z;
            let window = params.window_m + params.window_deviations * depth_deviation(z);
            let is_of_cell = abs(shown[cell].z - z) <= window;
            // A frame more, so that what has come to rest is tracked against once and agrees then.
            falls = (marks[cell] & DYNAMIC) != 0u && is_of_cell && confidence >= params.stable + 1.0;
        }
        if falls {
            places[index - params.first].w = min(confidence, params.fallen);
            atomicAdd(&counters[DEMOTED], 1u);
        }
    }
}
