// Of the surfels that fall into a pixel those near its measurement compete for it: the best known one wins (Keller et al. 2013,
// section 5.2). Each surfel is compared with the measurement itself, so that the index map is as fine as one can be: no two surfels share
// a cell of it.
import package::shared::camera::{Camera, project};
import package::shared::surfel::{SEEN, IN_FRONT, depth_deviation};

struct Params {
    camera: Camera,
    room: u32,
    // Largest difference in depth: metres, and standard deviations more.
    window_m: f32,
    window_deviations: f32,
    // Least cosine of the angle between the normals.
    least_cosine: f32,
    // In front of what is measured from here on: metres, and standard deviations more.
    free_m: f32,
    free_deviations: f32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> centres: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> discs: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> normals: array<vec4<f32>>;
// One plus the pixel that a surfel competes for, or, with the highest bit set, that it stands in front of; otherwise 0.
@group(0) @binding(6) var<storage, read_write> targets: array<u32>;
// The largest confidence's bits; zeroed memory has none.
@group(0) @binding(7) var<storage, read_write> best: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    let size = params.camera.size;
    for (var i = id.x; i < count; i += groups.x * 64u) {
        targets[i] = 0u;
        let centre = centres[i];
        let position = floor(project(params.camera, centre.xyz) + 0.5);
        if any(position < vec2(0.0)) || any(position >= vec2<f32>(size)) {
            continue;
        }
        let pixel = u32(position.y) * size.x + u32(position.x);
        let vertex = vertices[pixel];
        let normal = normals[pixel];
        if vertex.w == 0.0 {
            continue;
        }
        let deviation = depth_deviation(vertex.z);
        if vertex.z - centre.z > params.free_m + params.free_deviations * deviation {
            targets[i] = (pixel + 1u) | IN_FRONT;
            continue;
        }
        let window = params.window_m + params.window_deviations * deviation;
        if normal.w == 0.0 || abs(vertex.z - centre.z) > window || dot(normal.xyz, discs[i].xyz) < params.least_cosine {
            continue;
        }
        targets[i] = pixel + 1u;
        atomicMax(&best[pixel], bitcast<u32>(centre.w));
    }
}
