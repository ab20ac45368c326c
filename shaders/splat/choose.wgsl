// Large discs show where they are better known than what else a pixel shows.
import package::shared::camera::Camera;
import package::shared::disc::{Disc, OTHERS, depth_on_disc, pixels_of_disc, rank_of_known};
import package::shared::span::span;
import package::shared::surfel::{PREFERRED, depth_of, key_of_rank, last_depth};

struct Params {
    camera: Camera,
    largest_px: f32,
    window_m: f32,
    window_deviations: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> large: array<u32>;
@group(0) @binding(2) var<storage, read> discs: array<Disc>;
@group(0) @binding(3) var<storage, read> nearest: array<u32>;
// Keys of cells' ranks; 0 where there is nothing.
@group(0) @binding(4) var<storage, read_write> chosen: array<atomic<u32>>;

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
        let key = key_of_rank(rank_of_known(disc.known), cell);
        let pixels = pixels_of_disc(params.camera, disc.centre, disc.normal, disc.radius, params.largest_px);
        // One loop, so that invocations that run together wait for the largest box alone.
        var x = pixels.x;
        var y = pixels.y;
        while y < pixels.w && x < pixels.z {
            let z = depth_on_disc(params.camera, vec2(f32(x), f32(y)), disc.centre, disc.normal, disc.radius);
            let pixel = u32(y) * params.camera.size.x + u32(x);
            let front = nearest[pixel];
            let is_alike = ((front & PREFERRED) != 0u) == is_preferred;
            let last_z = last_depth(depth_of(front), params.window_m, params.window_deviations);
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
