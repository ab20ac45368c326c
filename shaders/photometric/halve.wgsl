// Halves a list of coloured points along both axes: the mean of those of a 2x2 group that lie within `reach` of its first
// one, for the next coarser level of `photometric/sums`.

struct Params {
    // Of the list that is read, as an image.
    size: vec2<u32>,
    // Of the list that is written.
    half_size: vec2<u32>,
    // In metres, for points a metre away from the camera; it grows with their depth.
    reach: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
    // The camera's centre (world frame).
    camera: vec4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> list: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> halved: array<vec4<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let cells = params.half_size.x * params.half_size.y;
    for (var i = id.x; i < cells; i += groups.x * 64u) {
        let cell = vec2(i % params.half_size.x, i / params.half_size.x);
        var anchor = vec3(0.0);
        var reach = 0.0;
        var sum = vec3(0.0);
        var colours = vec3(0.0);
        var count = 0.0;
        for (var k = 0u; k < 4u; k++) {
            // A side of one cell has no second one.
            let p = min(2u * cell + vec2(k & 1u, k >> 1u), params.size - vec2(1u));
            let entry = list[p.y * params.size.x + p.x];
            let point = bitcast<vec3<f32>>(entry.xyz);
            let colour = unpack4x8unorm(entry.w);
            if colour.w > 0.0 {
                if count == 0.0 {
                    anchor = point;
                    reach = params.reach * distance(anchor, params.camera.xyz);
                }
                if distance(point, anchor) <= reach {
                    sum += point;
                    colours += colour.rgb;
                    count += 1.0;
                }
            }
        }
        let mean = 1.0 / max(count, 1.0);
        let colour = pack4x8unorm(vec4(colours * mean, f32(count > 0.0)));
        halved[i] = vec4(bitcast<vec3<u32>>(sum * mean), colour);
    }
}
