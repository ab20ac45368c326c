// Stable surfels of one page become unstable where what they belong to moves, or where they are seen through: they vanish unless they
// are observed again (Keller et al. 2013, section on dynamics).
import package::shared::camera::{Camera, project};
import package::shared::cells::{DYNAMIC, VACANT};
import package::shared::surfel::{SEEN, DEMOTED, IN_FRONT, depth_deviation, pixel_of};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    // Cells, and pixels to a cell's side.
    size: vec2<u32>,
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
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> targets: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> shown: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> facings: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> marks: array<u32>;
@group(0) @binding(7) var<storage, read_write> places: array<vec4<f32>>;

// Whether something has left one of the nine cells around.
fn is_vacant_near(cell: vec2<u32>) -> bool {
    for (var y = max(cell.y, 1u) - 1u; y < min(cell.y + 2u, params.size.y); y++) {
        for (var x = max(cell.x, 1u) - 1u; x < min(cell.x + 2u, params.size.x); x++) {
            if (marks[y * params.size.x + x] & VACANT) != 0u {
                return true;
            }
        }
    }
    return false;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&counters[SEEN]), params.room);
    let width = params.camera.size.x;
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let goal = targets[i].x;
        let index = listed[i];
        if index < params.first || index - params.first >= params.page {
            continue;
        }
        let place = places[index - params.first];
        let centre = (params.camera_from_world * vec4(place.xyz, 1.0)).xyz;
        let z = centre.z;
        var pixel = vec2(0u);
        if goal == 0u {
            let position = floor(project(params.camera, centre) + 0.5);
            if any(position < vec2(0.0)) || any(position >= vec2<f32>(params.camera.size)) {
                continue;
            }
            pixel = vec2<u32>(position);
        } else {
            let at = pixel_of(goal);
            pixel = vec2(at % width, at / width);
        }
        let cell = pixel / params.side;
        let at = cell.y * params.size.x + cell.x;
        // It was removed where this is 0.
        let confidence = place.w;
        let window = params.window_m + params.window_deviations * depth_deviation(z);
        var falls = false;
        if goal == 0u {
            // No measurement says anything of it, as where an object stood on the floor: it left with what was around it.
            let above = dot(facings[at].xyz, centre - shown[at].xyz);
            falls = confidence >= params.stable && shown[at].w > 0.0 && above > window && is_vacant_near(cell);
        } else if (goal & IN_FRONT) != 0u {
            falls = confidence >= params.stable && is_vacant_near(cell);
        } else {
            // A frame more, so that what has come to rest is tracked against once and agrees then.
            let is_of_cell = abs(shown[at].z - z) <= window;
            falls = confidence >= params.stable + 1.0 && (marks[at] & DYNAMIC) != 0u && is_of_cell;
        }
        if falls {
            places[index - params.first].w = min(confidence, params.fallen);
            atomicAdd(&counters[DEMOTED], 1u);
        }
    }
}
