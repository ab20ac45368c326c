// Colour to intensity between 0 and 1: 0.299 R + 0.587 G + 0.114 B (the report, section 3.1.3). Pixels without a colour, whose
// fourth byte is 0, become -1.

struct Params {
    size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> colour: array<u32>;
@group(0) @binding(2) var<storage, read_write> intensity: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let c = unpack4x8unorm(colour[i]);
        intensity[i] = select(-1.0, dot(c.rgb, vec3(0.299, 0.587, 0.114)), c.a > 0.0);
    }
}
