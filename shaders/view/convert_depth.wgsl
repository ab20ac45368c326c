// Raw 16-bit depth to metres: affine, or a Kinect's disparity (the report's calibration). Values of 0 and 65535, and
// depths out of range, become 0, which means 'no measurement'.

struct Params {
    size: vec2<u32>,
    // 0: depth = raw * a + b. 1: depth = b / (a - raw), with b the factor 8 * baseline * focal length.
    kind: u32,
    a: f32,
    b: f32,
    near_m: f32,
    far_m: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
// Two values a word, the lower half first.
@group(0) @binding(1) var<storage, read> raw: array<u32>;
@group(0) @binding(2) var<storage, read_write> depth: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let value = (raw[i >> 1u] >> ((i & 1u) * 16u)) & 0xffffu;
        var z = 0.0;
        if value != 0u && value != 0xffffu {
            if params.kind == 0u {
                z = f32(value) * params.a + params.b;
            } else {
                z = params.b / (params.a - f32(value));
            }
        }
        // Also false for what is not a number.
        depth[i] = select(0.0, z, z >= params.near_m && z <= params.far_m);
    }
}
