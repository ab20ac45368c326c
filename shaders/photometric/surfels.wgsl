// Lists points of an image of surfels with the surfels' own colours, one for each cell of STRIDE pixels, for `photometric/sums`.

struct Params {
    // Of the model's image.
    size: vec2<u32>,
    // Of the list, as an image.
    list_size: vec2<u32>,
    stride: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
// Red, green, blue from the lowest byte up, and 255; 0 where there is none.
@group(0) @binding(2) var<storage, read> colours: array<u32>;
// World coordinates (bits of floats), and the colour as four bytes; the last one is 0 where there is no point.
@group(0) @binding(3) var<storage, read_write> list: array<vec4<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let cells = params.list_size.x * params.list_size.y;
    for (var i = id.x; i < cells; i += groups.x * 64u) {
        let cell = vec2(i % params.list_size.x, i / params.list_size.x);
        let middle = min(cell * params.stride + vec2(params.stride / 2u), params.size - vec2(1u));
        let at = middle.y * params.size.x + middle.x;
        list[i] = vec4(bitcast<vec3<u32>>(points[at].xyz), select(0u, colours[at], points[at].w > 0.0));
    }
}
