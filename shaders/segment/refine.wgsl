// Takes marks over from the cells of twice the size: what is of one surface with a coarse cell that is dynamic is so too.
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
@group(0) @binding(3) var<storage, read_write> marks: array<u32>;
@group(0) @binding(4) var<storage, read> coarse_places: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> coarse_facings: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> coarse_marks: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.size.x * params.size.y; i += groups.x * 64u) {
        let coarse = (i / params.size.x / 2u) * params.half_size.x + (i % params.size.x) / 2u;
        let place = places[i];
        let most_m = params.alike_m + params.alike_deviations * depth_deviation(place.z);
        let is_one = is_alike(place, facings[i], coarse_places[coarse], coarse_facings[coarse], most_m, params.least_cosine);
        if (coarse_marks[coarse] & DYNAMIC) != 0u && is_one {
            marks[i] |= DYNAMIC;
        }
    }
}
