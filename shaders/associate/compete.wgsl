// Of the surfels of one page that fall into a pixel those near its measurement compete for it: the best known one wins, the first of those
// about as well known (Keller et al. 2013, section 5.2). Each surfel is compared with the measurement itself, so that the index map is as fine as one can be: no two surfels share
// a cell of it.
import package::shared::camera::{Camera, project};
import package::shared::surfel::{Attributes, SEEN, IN_FRONT, KNOWN, OLD, REFUTED, depth_deviation, key_of, unpack_normal};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    first: u32,
    page: u32,
    room: u32,
    // Largest difference in depth: metres, and standard deviations more.
    window_m: f32,
    window_deviations: f32,
    // Least cosine of the angle between the normals.
    least_cosine: f32,
    // In front of what is measured from here on: metres, and standard deviations more.
    free_m: f32,
    free_deviations: f32,
    // Confidence from which on a surfel was seen more than once.
    known: f32,
    stable: f32,
    frame: u32,
    // Frames after which an unstable surfel is removed that is looked at again, and not observed.
    patience: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> attributes: array<Attributes>;
@group(0) @binding(5) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> normals: array<vec4<f32>>;
// One plus the pixel that a surfel competes for, or, by the bits above, that it stands in front of, or that looks at it and measures
// something else; otherwise 0.
@group(0) @binding(7) var<storage, read_write> targets: array<u32>;
// Keys of the surfels that win; zeroed memory has none.
@group(0) @binding(8) var<storage, read_write> best: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    let size = params.camera.size;
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let at = listed[i] - params.first;
        if listed[i] < params.first || at >= params.page {
            continue;
        }
        targets[i] = 0u;
        let place = places[at];
        let centre = (params.camera_from_world * vec4(place.xyz, 1.0)).xyz;
        let position = floor(project(params.camera, centre) + 0.5);
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
        let unseen = params.frame - min(params.frame, attributes[at].z);
        let old = select(0u, OLD, place.w < params.stable && unseen > params.patience);
        if vertex.z - centre.z > params.free_m + params.free_deviations * deviation {
            targets[i] = (pixel + 1u) | IN_FRONT | old | select(0u, KNOWN, place.w >= params.known);
            continue;
        }
        let facing = (params.camera_from_world * vec4(unpack_normal(attributes[at].x), 0.0)).xyz;
        let window = params.window_m + params.window_deviations * deviation;
        if normal.w == 0.0 {
            continue;
        }
        if abs(vertex.z - centre.z) > window || dot(normal.xyz, facing) < params.least_cosine {
            // What is measured before it says nothing of it.
            if old != 0u && vertex.z - centre.z >= -window {
                targets[i] = (pixel + 1u) | OLD | REFUTED;
            }
            continue;
        }
        targets[i] = (pixel + 1u) | old;
        atomicMax(&best[pixel], key_of(place.w, i));
    }
}
