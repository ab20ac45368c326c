// Lists surface points with the map's own colours, one for each cell of STRIDE pixels of the model's image, for
// `photometric/sums` (the report, section 3.1.2).
import package::shared::colour::colour_at;
import package::shared::map::Map;

struct Params {
    map: Map,
    // Of the model's image.
    size: vec2<u32>,
    // Of the list, as an image.
    list_size: vec2<u32>,
    stride: u32,
    // Points observed less often are left out.
    least_confidence: f32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
// World coordinates (bits of floats), and the colour as four bytes; the last one is 0 where there is no point.
@group(0) @binding(2) var<storage, read_write> list: array<vec4<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let cells = params.list_size.x * params.list_size.y;
    for (var i = id.x; i < cells; i += groups.x * 64u) {
        let cell = vec2(i % params.list_size.x, i / params.list_size.x);
        let at = min(cell * params.stride + vec2(params.stride / 2u), params.size - vec2(1u));
        let point = points[at.y * params.size.x + at.x];
        var colour = vec4(0.0);
        if point.w >= params.least_confidence + 1.0 {
            colour = colour_at(params.map, point.xyz);
        }
        list[i] = vec4(bitcast<vec3<u32>>(point.xyz), pack4x8unorm(colour));
    }
}
