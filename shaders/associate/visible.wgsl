// Which surfels of one page lie in the view, and how many of each 32 slots do. The slots' bits lie behind the counts of all pages.
// With `of_submap` those of one submap alone; with `combined` those of all, as they lie in the world.
// With `removing`, those that stayed unstable and were not seen for long are removed on the way.
import package::shared::camera::Camera;
import package::shared::surfel::{Attributes, USED, REMOVED, STABLE, submap_of};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    // The page's first surfel, and how many it has room for.
    first: u32,
    page: u32,
    // Counts of all pages.
    chunks: u32,
    // Pixels beyond the border at which a surfel still counts as seen.
    margin: f32,
    // Surfels of less confidence are left out.
    least_confidence: f32,
    stable: f32,
    frame: u32,
    // Frames after which an unstable surfel that was not observed again is removed, wherever it is.
    forget_after: u32,
    submap: u32,
    // Of other submaps, surfels of less confidence are removed: no frame will tell more of them soon.
    kept_elsewhere: f32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> counters: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read_write> places: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> attributes: array<Attributes>;
@group(0) @binding(4) var<storage, read_write> seen: array<u32>;
@if(combined) @group(0) @binding(5) var<storage, read> camera_from_submaps: array<mat4x4<f32>>;

// Frames from one that removes what was not seen for long to the next.
const FORGETS_EVERY: u32 = 16u;

// Without divisions: the position on the image, times the depth.
fn is_in_view(p: vec3<f32>) -> bool {
    let range = params.camera.depth_range;
    let pixel = params.camera.focal * p.xy + params.camera.centre * p.z;
    let last = (vec2<f32>(params.camera.size) - 1.0 + params.margin) * p.z;
    return p.z >= range.x && p.z <= range.y && all(pixel >= vec2(-params.margin * p.z)) && all(pixel <= last);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let used = atomicLoad(&counters[USED]);
    let count = min(params.page, used - min(params.first, used));
    // Now and then: it takes a look at most of the map.
    let forgets = params.frame % FORGETS_EVERY == 0u;
    var stable = 0u;
    var removed = 0u;
    for (var chunk = id.x; chunk * 32u < params.page && params.first / 32u + chunk < params.chunks; chunk += groups.x * 64u) {
        let first = chunk * 32u;
        let last = min(first + 32u, count);
        var bits = 0u;
        for (var i = first; i < last; i++) {
            let place = places[i];
            var is_meant = place.w > 0.0;
            @if(of_submap) {
                is_meant = is_meant && submap_of(attributes[i].y) == params.submap;
            }
            @if(removing) {
                stable += u32(place.w >= params.stable);
                var is_forgotten = false;
                if forgets && is_meant && place.w < params.stable {
                    is_forgotten = params.frame - min(params.frame, attributes[i].z) > params.forget_after;
                }
                @if(of_submap) {
                    is_forgotten = is_forgotten || (!is_meant && place.w > 0.0 && place.w < params.kept_elsewhere);
                }
                if is_forgotten {
                    places[i] = vec4(0.0);
                    removed += 1u;
                    is_meant = false;
                }
            }
            @if(!combined) let camera_from_surfel = params.camera_from_world;
            @if(combined) let camera_from_surfel = camera_from_submaps[submap_of(attributes[i].y)];
            let p = (camera_from_surfel * vec4(place.xyz, 1.0)).xyz;
            bits |= select(0u, 1u << (i - first), is_meant && place.w >= params.least_confidence && is_in_view(p));
        }
        let at = params.first / 32u + chunk;
        seen[at] = countOneBits(bits);
        seen[params.chunks + at] = bits;
    }
    @if(removing) {
        if stable > 0u {
            atomicAdd(&counters[STABLE], stable);
        }
        if removed > 0u {
            atomicAdd(&counters[REMOVED], removed);
        }
    }
}
