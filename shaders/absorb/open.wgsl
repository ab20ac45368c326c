// Measurements that no surfel was found for, and that are good enough to become surfels: their pixels' bits, and a list of them.
import package::shared::camera::Camera;

struct Params {
    camera: Camera,
    chunks: u32,
    // Least cosine between ray and normal.
    least_cosine: f32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> normals: array<vec4<f32>>;
// The complements of surfels' indices, or 0.
@group(0) @binding(3) var<storage, read> chosen: array<u32>;
// Bits of 32 pixels each, behind their counts; all zero before.
@group(0) @binding(4) var<storage, read_write> wanted: array<atomic<u32>>;
// How many pixels there are, and behind that which. In whatever order: each is looked at for itself.
@group(0) @binding(5) var<storage, read_write> open: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.camera.size.x * params.camera.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        if chosen[i] != 0u {
            continue;
        }
        let vertex = vertices[i].xyz;
        let normal = normals[i];
        if normal.w > 0.0 && -dot(vertex, normal.xyz) >= params.least_cosine * length(vertex) {
            atomicOr(&wanted[params.chunks + i / 32u], 1u << (i % 32u));
            atomicStore(&open[1u + atomicAdd(&open[0], 1u)], i);
        }
    }
}
