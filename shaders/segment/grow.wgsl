// One step of growing: a cell is dynamic if one of the eight around it is, and both are of one surface; it is vacant if one around it
// is, and something of its own is seen through. Old marks are read and new ones written, so that no order shows.
import package::shared::cells::{DYNAMIC, VACANT, PARTLY_VACANT, is_alike};
import package::shared::surfel::depth_deviation;

struct Params {
    size: vec2<u32>,
    // Distance from each other's planes: metres, and standard deviations more.
    alike_m: f32,
    alike_deviations: f32,
    // Between their normals.
    least_cosine: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> facings: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> marks: array<u32>;
@group(0) @binding(4) var<storage, read_write> grown: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let width = params.size.x;
    for (var i = id.x; i < width * params.size.y; i += groups.x * 64u) {
        let x = i % width;
        let y = i / width;
        let place = places[i];
        let facing = facings[i];
        let most_m = params.alike_m + params.alike_deviations * depth_deviation(place.z);
        var found = marks[i];
        for (var v = max(y, 1u) - 1u; v < min(y + 2u, params.size.y); v++) {
            for (var u = max(x, 1u) - 1u; u < min(x + 2u, width); u++) {
                let at = v * width + u;
                let other = marks[at];
                if (other & DYNAMIC) != 0u && is_alike(place, facing, places[at], facings[at], most_m, params.least_cosine) {
                    found |= DYNAMIC;
                }
                if (other & VACANT) != 0u && (found & PARTLY_VACANT) != 0u {
                    found |= VACANT;
                }
            }
        }
        grown[i] = found;
    }
}
