// Where each point of the image before falls in this one, and which depth is the nearest at each pixel. Targets are kept,
// so that the next pass compares the very same numbers.
import package::shared::camera::{Camera, project};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
// World frame; w is 0 where there is none.
@group(0) @binding(1) var<storage, read> before: array<vec4<f32>>;
// One plus the pixel, or zero, and the depth's bits.
@group(0) @binding(2) var<storage, read_write> targets: array<vec2<u32>>;
// The nearest depth as the complement of its bits; zeroed memory holds none.
@group(0) @binding(3) var<storage, read_write> nearest: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let size = params.camera.size;
    for (var i = id.x; i < size.x * size.y; i += groups.x * 64u) {
        targets[i] = vec2(0u);
        let point = before[i];
        if point.w == 0.0 {
            continue;
        }
        let p = (params.camera_from_world * vec4(point.xyz, 1.0)).xyz;
        if p.z < params.camera.depth_range.x || p.z > params.camera.depth_range.y {
            continue;
        }
        let position = floor(project(params.camera, p) + 0.5);
        if any(position < vec2(0.0)) || any(position >= vec2<f32>(size)) {
            continue;
        }
        let pixel = u32(position.y) * size.x + u32(position.x);
        let depth = bitcast<u32>(p.z);
        targets[i] = vec2(pixel + 1u, depth);
        atomicMax(&nearest[pixel], ~depth);
    }
}
