// Cells of twice the size: the first place of the four, and the marks of any, of those that are of one surface with it.
import package::shared::cells::{DYNAMIC, is_alike};
import package::shared::surfel::depth_deviation;

struct Params {
    // Of the finer cells.
    size: vec2<u32>,
    // Of the coarser ones.
    half_size: vec2<u32>,
    alike_m: f32,
    alike_deviations: f32,
    least_cosine: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> facings: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> marks: array<u32>;
@group(0) @binding(4) var<storage, read_write> coarse_places: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> coarse_facings: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> coarse_marks: array<u32>;

fn child(first: vec2<u32>, k: u32) -> u32 {
    let cell = min(first + vec2(k & 1u, k >> 1u), params.size - vec2(1u));
    return cell.y * params.size.x + cell.x;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.half_size.x * params.half_size.y; i += groups.x * 64u) {
        let first = 2u * vec2(i % params.half_size.x, i / params.half_size.x);
        var shown = first.y * params.size.x + first.x;
        for (var k = 0u; k < 4u && places[shown].w == 0.0; k++) {
            shown = child(first, k);
        }
        let place = places[shown];
        let facing = facings[shown];
        let most_m = params.alike_m + params.alike_deviations * depth_deviation(place.z);
        var found = 0u;
        for (var k = 0u; k < 4u; k++) {
            let at = child(first, k);
            let is_one = is_alike(place, facing, places[at], facings[at], most_m, params.least_cosine);
            found |= select(marks[at] & ~DYNAMIC, marks[at], is_one);
        }
        coarse_places[i] = place;
        coarse_facings[i] = facing;
        coarse_marks[i] = found;
    }
}
