// The nearest depth at which each pixel's ray meets a disc: one that is known well enough, or, where there is none, any other.
import package::shared::camera::Camera;
import package::shared::disc::{depth_on_disc, pixels_of_disc};
import package::shared::surfel::{SEEN, PREFERRED};

struct Params {
    camera: Camera,
    room: u32,
    reach: f32,
    largest_px: f32,
    // Discs of at least this confidence hide all others.
    preferred: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> centres: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> discs: array<vec4<f32>>;
// The complement of the depth's bits; zeroed memory has none.
@group(0) @binding(4) var<storage, read_write> nearest: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(counters[SEEN], params.room);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let centre = centres[i].xyz;
        let disc = discs[i];
        let radius = disc.w * params.reach;
        let is_preferred = centres[i].w >= params.preferred;
        let pixels = pixels_of_disc(params.camera, centre, radius, params.largest_px);
        for (var y = pixels.y; y < pixels.w; y++) {
            for (var x = pixels.x; x < pixels.z; x++) {
                let z = depth_on_disc(params.camera, vec2(f32(x), f32(y)), centre, disc.xyz, radius);
                if z > 0.0 {
                    let bits = ~bitcast<u32>(z);
                    let at = u32(y) * params.camera.size.x + u32(x);
                    atomicMax(&nearest[at], select(bits & ~PREFERRED, bits, is_preferred));
                }
            }
        }
    }
}
