// Of the surfels of one page that fall into a pixel those near its measurement compete for it: the best known one wins, the first of those
// about as well known (Keller et al. 2013, section 5.2). Each surfel is compared with the measurement itself, so that the index map is as fine as one can be: no two surfels share
// a cell of it.
import package::shared::camera::{Camera, project};
import package::shared::span::span;
import package::shared::surfel::{Attributes, SEEN, IN_FRONT, KNOWN, OLD, REFUTED, depth_deviation, key_of, mark_of, unpack_normal};

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
// Measured, in metres; 0 where nothing was.
@group(0) @binding(5) var<storage, read> depth: array<f32>;
@group(0) @binding(6) var<storage, read> normals: array<vec4<f32>>;
// One plus the pixel that a surfel competes for, or, by the bits above, that it stands in front of, or that looks at it and measures
// something else; otherwise 0. And its mark, in which those that are stable are preferred.
@group(0) @binding(7) var<storage, read_write> targets: array<vec2<u32>>;
// Keys of the surfels that win; zeroed memory has none.
@group(0) @binding(8) var<storage, read_write> best: array<atomic<u32>>;

// Few on software drivers, whose invocations then read what lies next to each other.
override LANES: u32 = 64u;

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let part = span(min(counters[SEEN], params.room), group.x, groups.x);
    let size = params.camera.size;
    for (var i = part.x + lane; i < part.y; i += LANES) {
        let index = listed[i];
        let at = index - params.first;
        if index < params.first || at >= params.page {
            continue;
        }
        // Without branches, which software drivers take lane by lane.
        let place = places[at];
        let own = attributes[at].xz;
        let centre = (params.camera_from_world * vec4(place.xyz, 1.0)).xyz;
        let facing = (params.camera_from_world * vec4(unpack_normal(own.x), 0.0)).xyz;
        let position = floor(project(params.camera, centre) + 0.5);
        let is_inside = all(position >= vec2(0.0)) && all(position < vec2<f32>(size));
        let pixel = select(0u, u32(position.y) * size.x + u32(position.x), is_inside);
        let z = depth[pixel];
        // All zero where there is none.
        let normal = normals[pixel].xyz;
        let is_measured = is_inside && z > 0.0;
        let deviation = depth_deviation(z);
        let window = params.window_m + params.window_deviations * deviation;
        let ahead = z - centre.z;
        let unseen = params.frame - min(params.frame, own.y);
        let is_old = place.w < params.stable && unseen > params.patience;
        let is_before = ahead > params.free_m + params.free_deviations * deviation;
        let has_normal = any(normal != vec3(0.0));
        let is_own = abs(ahead) <= window && dot(normal, facing) >= params.least_cosine;
        let competes = is_measured && !is_before && has_normal && is_own;
        // What is measured before it says nothing of it.
        let is_refuted = is_measured && !is_before && has_normal && !is_own && is_old && ahead >= -window;
        let before = IN_FRONT | select(0u, KNOWN, place.w >= params.known);
        let role = select(select(0u, REFUTED, is_refuted), before, is_before) | select(0u, OLD, is_old);
        let is_meant = competes || is_refuted || (is_measured && is_before);
        targets[i] = vec2(select(0u, (pixel + 1u) | role, is_meant), mark_of(centre.z, place.w, params.stable));
        if competes {
            atomicMax(&best[pixel], key_of(place.w, i));
        }
    }
}
