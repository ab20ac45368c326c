// Vertex and normal maps of a depth image (camera frame, metres; w is 1, or 0 where there is none). Normals come from
// central differences of the vertices, where the neighbours lie within `reach_m` in depth, and point to the camera.
import package::shared::camera::{Camera, unproject};

struct Params {
    camera: Camera,
    reach_m: f32,
    // Pixels to either side; where one of those is missing, the next ones count.
    apart: i32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read_write> vertices: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> normals: array<vec4<f32>>;

// The vertex at a pixel that may lie outside; w is 0 where there is none near `z`.
fn neighbour(pixel: vec2<i32>, z: f32) -> vec4<f32> {
    if any(pixel < vec2(0)) || any(pixel >= vec2<i32>(params.camera.size)) {
        return vec4(0.0);
    }
    let other = depth[u32(pixel.y) * params.camera.size.x + u32(pixel.x)];
    if other <= 0.0 || abs(other - z) > params.reach_m {
        return vec4(0.0);
    }
    return vec4(unproject(params.camera, vec2<f32>(pixel), other), 1.0);
}

// The normal by the neighbours so many pixels away; w is 0 where one of them is missing.
fn normal_between(pixel: vec2<i32>, vertex: vec3<f32>, apart: i32) -> vec4<f32> {
    let left = neighbour(pixel - vec2(apart, 0), vertex.z);
    let right = neighbour(pixel + vec2(apart, 0), vertex.z);
    let above = neighbour(pixel - vec2(0, apart), vertex.z);
    let below = neighbour(pixel + vec2(0, apart), vertex.z);
    let n = cross(right.xyz - left.xyz, below.xyz - above.xyz);
    let l = length(n);
    if left.w * right.w * above.w * below.w == 0.0 || l <= 1e-20 {
        return vec4(0.0);
    }
    return vec4(n * (select(1.0, -1.0, dot(n, vertex) > 0.0) / l), 1.0);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = params.camera.size;
    if any(id.xy >= size) {
        return;
    }
    let at = id.y * size.x + id.x;
    let z = depth[at];
    var vertex = vec4(0.0);
    var normal = vec4(0.0);
    if z > 0.0 {
        let pixel = vec2<i32>(id.xy);
        vertex = vec4(unproject(params.camera, vec2<f32>(pixel), z), 1.0);
        normal = normal_between(pixel, vertex.xyz, params.apart);
        if normal.w == 0.0 && params.apart > 1 {
            normal = normal_between(pixel, vertex.xyz, 1);
        }
    }
    vertices[at] = vertex;
    normals[at] = normal;
}
