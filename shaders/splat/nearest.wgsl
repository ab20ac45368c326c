// The nearest depth at which each pixel's ray meets a large disc: one that is known well enough, or, where there is none, any other.
import package::shared::camera::Camera;
import package::shared::disc::{Disc, OTHERS, depth_on_disc, pixels_of_disc};
import package::shared::span::span;
import package::shared::surfel::nearness_of;

struct Params {
    camera: Camera,
    largest_px: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> large: array<u32>;
@group(0) @binding(2) var<storage, read> discs: array<Disc>;
// The nearness of each pixel's nearest.
@group(0) @binding(3) var<storage, read_write> nearest: array<atomic<u32>>;

// Few on software drivers, whose invocations then read what lies next to each other.
override LANES: u32 = 64u;

@compute @workgroup_size(LANES)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let part = span(large[0], group.x, groups.x);
    for (var i = part.x + lane; i < part.y; i += LANES) {
        let cell = large[i + 1u];
        let disc = discs[cell];
        let is_preferred = disc.known > OTHERS;
        let pixels = pixels_of_disc(params.camera, disc.centre, disc.normal, disc.radius, params.largest_px);
        // One loop, so that invocations that run together wait for the largest box alone.
        var x = pixels.x;
        var y = pixels.y;
        while y < pixels.w && x < pixels.z {
            let z = depth_on_disc(params.camera, vec2(f32(x), f32(y)), disc.centre, disc.normal, disc.radius);
            if z > 0.0 {
                let pixel = u32(y) * params.camera.size.x + u32(x);
                atomicMax(&nearest[pixel], nearness_of(z, is_preferred));
            }
            x += 1;
            let is_next = x == pixels.z;
            x = select(x, pixels.x, is_next);
            y += i32(is_next);
        }
    }
}
