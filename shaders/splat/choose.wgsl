// Which disc each pixel shows: of those within a window behind the nearest the best known; a surface's discs overlap. Discs that are less
// known than is preferred show only where none of the others does.
import package::shared::camera::Camera;
import package::shared::disc::{depth_on_disc, pixels_of_disc};
import package::shared::surfel::{Attributes, SEEN, PREFERRED, depth_deviation, key_of, submap_of, unpack_normal, unpack_radius};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    first: u32,
    page: u32,
    room: u32,
    reach: f32,
    largest_px: f32,
    // Depth behind the nearest: metres, and standard deviations more.
    window_m: f32,
    window_deviations: f32,
    preferred: f32,
    // Discs of less are not drawn.
    least: f32,
    // Unstable ones that were seen last before this frame neither.
    since: u32,
    stable: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> attributes: array<Attributes>;
@group(0) @binding(5) var<storage, read> nearest: array<u32>;
// Keys of surfels; zeroed memory has none.
@group(0) @binding(6) var<storage, read_write> chosen: array<atomic<u32>>;
@if(combined) @group(0) @binding(7) var<storage, read> camera_from_submaps: array<mat4x4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let at = listed[i] - params.first;
        if listed[i] < params.first || at >= params.page {
            continue;
        }
        let place = places[at];
        if place.w <= 0.0 || place.w < params.least {
            continue;
        }
        let own = attributes[at];
        if place.w < params.stable && own.z < params.since {
            continue;
        }
        @if(!combined) let camera_from_surfel = params.camera_from_world;
        @if(combined) let camera_from_surfel = camera_from_submaps[submap_of(own.y)];
        let centre = (camera_from_surfel * vec4(place.xyz, 1.0)).xyz;
        let normal = (camera_from_surfel * vec4(unpack_normal(own.x), 0.0)).xyz;
        let radius = unpack_radius(own.y) * params.reach;
        let is_preferred = place.w >= params.preferred;
        let key = key_of(place.w, i);
        let pixels = pixels_of_disc(params.camera, centre, normal, radius, params.largest_px);
        var x = pixels.x;
        var y = pixels.y;
        while y < pixels.w && x < pixels.z {
            let z = depth_on_disc(params.camera, vec2(f32(x), f32(y)), centre, normal, radius);
            let pixel = u32(y) * params.camera.size.x + u32(x);
            let front = nearest[pixel];
            let is_alike = ((front & PREFERRED) != 0u) == is_preferred;
            let first_z = bitcast<f32>(~(front | PREFERRED));
            let last_z = first_z + params.window_m + params.window_deviations * depth_deviation(first_z);
            if z > 0.0 && is_alike && z <= last_z {
                atomicMax(&chosen[pixel], key);
            }
            x += 1;
            let is_next = x == pixels.z;
            x = select(x, pixels.x, is_next);
            y += i32(is_next);
        }
    }
}
