// The map's colour at each point of a raycast image.
import package::shared::colour::colour_at;
import package::shared::map::Map;

struct Params {
    map: Map,
    size: vec2<u32>,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> image: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let point = points[i];
        var colour = vec4(0.0);
        if point.w > 0.0 {
            colour = colour_at(params.map, point.xyz);
        }
        image[i] = pack4x8unorm(colour);
    }
}
