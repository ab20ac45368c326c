// Which surfels of one page lie in the view, and where (camera frame). They are listed in no order: what is made of the list does
// not depend on it. With `removing`, surfels that stayed unstable for too long are removed on the way.
import package::shared::camera::{Camera, project};
import package::shared::surfel::{Attributes, USED, SEEN, REMOVED, STABLE, unpack_normal};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    // The page's first surfel, and how many it has room for.
    first: u32,
    page: u32,
    // The list's room.
    room: u32,
    // Pixels beyond the border at which a surfel still counts as seen.
    margin: f32,
    // Surfels of less confidence are left out.
    least_confidence: f32,
    stable: f32,
    frame: u32,
    // Frames after which an unstable surfel that was not observed again is removed.
    patience: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read_write> places: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> attributes: array<Attributes>;
@group(0) @binding(4) var<storage, read_write> listed: array<u32>;
// Centre and confidence, normal and radius, both in the camera's frame.
@group(0) @binding(5) var<storage, read_write> centres: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> discs: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let used = atomicLoad(&counters[USED]);
    let count = min(params.page, used - min(params.first, used));
    let least = vec2(-params.margin);
    let most = vec2<f32>(params.camera.size) - 1.0 + params.margin;
    var stable = 0u;
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let place = places[i];
        if place.w == 0.0 {
            continue;
        }
        @if(removing) {
            if place.w >= params.stable {
                stable += 1u;
            } else if params.frame - min(params.frame, attributes[i].z) > params.patience {
                places[i] = vec4(0.0);
                atomicAdd(&counters[REMOVED], 1u);
                continue;
            }
        }
        if place.w < params.least_confidence {
            continue;
        }
        let p = (params.camera_from_world * vec4(place.xyz, 1.0)).xyz;
        if p.z < params.camera.depth_range.x || p.z > params.camera.depth_range.y {
            continue;
        }
        let pixel = project(params.camera, p);
        if any(pixel < least) || any(pixel > most) {
            continue;
        }
        let at = atomicAdd(&counters[SEEN], 1u);
        if at < params.room {
            let own = attributes[i];
            let n = (params.camera_from_world * vec4(unpack_normal(own.x), 0.0)).xyz;
            listed[at] = params.first + i;
            centres[at] = vec4(p, place.w);
            discs[at] = vec4(n, bitcast<f32>(own.y));
        }
    }
    @if(removing) {
        if stable > 0u {
            atomicAdd(&counters[STABLE], stable);
        }
    }
}
