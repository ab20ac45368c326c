// Colours a raycast image by its normals: shaded grey with the light at the camera (Lambert), or the normals themselves.

struct Params {
    size: vec2<u32>,
    // 0: shaded grey. 1: normals.
    kind: u32,
    unused: u32,
    // The camera's centre (world frame).
    camera: vec4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> normals: array<vec4<f32>>;
// Red, green, blue, alpha from the lowest byte up; all zero where the ray hits nothing.
@group(0) @binding(3) var<storage, read_write> image: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let normal = normals[i];
        var colour = vec4(0.0);
        if normal.w > 0.0 {
            if params.kind == 0u {
                let light = normalize(params.camera.xyz - points[i].xyz);
                colour = vec4(vec3(0.15 + 0.8 * abs(dot(normal.xyz, light))), 1.0);
            } else {
                colour = vec4(0.5 + 0.5 * normal.xyz, 1.0);
            }
        }
        image[i] = pack4x8unorm(colour);
    }
}
