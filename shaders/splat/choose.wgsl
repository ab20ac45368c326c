// Which disc each pixel shows: of those within a window behind the nearest the first, which was made first and so tends to be the best
// known; a surface's discs overlap. Discs that are less known show only where none of the others does.
import package::shared::camera::Camera;
import package::shared::disc::{depth_on_disc, pixels_of_disc};
import package::shared::surfel::{SEEN, PREFERRED};

struct Params {
    camera: Camera,
    room: u32,
    reach: f32,
    largest_px: f32,
    window_m: f32,
    preferred: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> centres: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> discs: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> nearest: array<u32>;
@group(0) @binding(5) var<storage, read> listed: array<u32>;
// The complement of the surfel's index; zeroed memory has none.
@group(0) @binding(6) var<storage, read_write> chosen: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let centre = centres[i].xyz;
        let is_preferred = centres[i].w >= params.preferred;
        let disc = discs[i];
        let radius = disc.w * params.reach;
        let pixels = pixels_of_disc(params.camera, centre, radius, params.largest_px);
        for (var y = pixels.y; y < pixels.w; y++) {
            for (var x = pixels.x; x < pixels.z; x++) {
                let z = depth_on_disc(params.camera, vec2(f32(x), f32(y)), centre, disc.xyz, radius);
                let at = u32(y) * params.camera.size.x + u32(x);
                let is_alike = ((nearest[at] & PREFERRED) != 0u) == is_preferred;
                if z > 0.0 && is_alike && z <= bitcast<f32>(~(nearest[at] | PREFERRED)) + params.window_m {
                    atomicMax(&chosen[at], ~listed[i]);
                }
            }
        }
    }
}
