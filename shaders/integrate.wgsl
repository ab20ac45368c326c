// Fuses a frame's depth, and colour, into the visible blocks of one page (Curless & Levoy 1996; Newcombe et al. 2011,
// section 3.3; the report, section 3.3). Eight lanes take a block, each a column of x, so that they read neighbouring
// words; eight blocks a workgroup.
import package::shared::camera::{Camera, project, inside};
import package::shared::map::{Map, VISIBLE, BLOCK_VOXELS, unpack_position};
import package::shared::running_colour::with_colour;
import package::shared::distance::{Voxel, NEARLY_EMPTY, unpack_distance, unpack_weight, pack_distance};

struct Params {
    depth_camera: Camera,
    colour_camera: Camera,
    camera_from_world: mat4x4<f32>,
    colour_from_world: mat4x4<f32>,
    map: Map,
    page: u32,
    max_weight: u32,
    stop_at_max_weight: u32,
    // Share of the truncation band in which colour is fused.
    colour_band: f32,
    // What a voxel that claims to be near a surface loses of its weight where it is seen to be empty.
    empty_loss: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> visible: array<u32>;
@group(0) @binding(3) var<storage, read> keys: array<vec2<u32>>;
@if(!weighted && !confidence) @group(0) @binding(4) var<storage, read> depth: array<f32>;
@group(0) @binding(5) var<storage, read_write> distances: array<Voxel>;
@if(colour) @group(0) @binding(6) var<storage, read> image: array<u32>;
@if(colour) @group(0) @binding(7) var<storage, read_write> colours: array<u32>;
// Depth, and how much it counts, a whole number of at least 1 (view/observations). One buffer in place of two, so that
// there is room for another below the limit of eight.
@if(weighted || confidence) @group(0) @binding(8) var<storage, read> observations: array<vec2<f32>>;
@if(confidence) @group(0) @binding(9) var<storage, read_write> confidences: array<f32>;

// What the best observation adds to a weight by noise.
@if(confidence) const BEST_OBSERVATION: f32 = 16.0;

@if(colour) fn texel(x: u32, y: u32) -> vec4<f32> {
    return unpack4x8unorm(image[y * params.colour_camera.size.x + x]) * 255.0;
}

@if(colour) fn fuse_colour(at: u32, world: vec3<f32>) {
    let p = (params.colour_from_world * vec4(world, 1.0)).xyz;
    if p.z <= 0.0 {
        return;
    }
    let pixel = project(params.colour_camera, p);
    if !inside(params.colour_camera, pixel) {
        return;
    }
    let base = vec2<u32>(pixel);
    let f = pixel - floor(pixel);
    let next = min(base + vec2(1u), params.colour_camera.size - vec2(1u));
    let a = texel(base.x, base.y);
    let b = texel(next.x, base.y);
    let c = texel(base.x, next.y);
    let d = texel(next.x, next.y);
    // A fourth byte of 0 marks pixels without a colour.
    if min(min(a.a, b.a), min(c.a, d.a)) == 0.0 {
        return;
    }
    let observed = mix(mix(a.rgb, b.rgb, f.x), mix(c.rgb, d.rgb, f.x), f.y);

    colours[at] = with_colour(colours[at], observed, params.max_weight);
}

@compute @workgroup_size(64)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let voxel = params.map.voxel_size_m;
    let per_mu = 1.0 / params.map.truncation_m;
    let x = lane & 7u;
    for (var i = group.x * 8u + (lane >> 3u); i < counters[VISIBLE]; i += groups.x * 8u) {
        let block = visible[i];
        if (block >> params.map.page_shift) != params.page {
            continue;
        }
        let in_page = block & ((1u << params.map.page_shift) - 1u);
        let corner = (vec3<f32>(unpack_position(keys[block])) * 8.0 + vec3(f32(x), 0.0, 0.0)) * voxel;
        let corner_camera = (params.camera_from_world * vec4(corner, 1.0)).xyz;
        let along_y = params.camera_from_world[1].xyz * voxel;
        let along_z = params.camera_from_world[2].xyz * voxel;
        @if(colour) var near_surface = vec2(0u);
        for (var z = 0u; z < 8u; z++) {
            for (var y = 0u; y < 8u; y++) {
                let p = corner_camera + f32(y) * along_y + f32(z) * along_z;
                if p.z <= 0.0 {
                    continue;
                }
                // Nearest pixel: interpolating would mix foreground and background.
                let pixel = project(params.depth_camera, p) + 0.5;
                if any(pixel < vec2(0.0)) || any(pixel >= vec2<f32>(params.depth_camera.size)) {
                    continue;
                }
                let pixel_at = u32(pixel.y) * params.depth_camera.size.x + u32(pixel.x);
                @if(!weighted && !confidence) let measured = depth[pixel_at];
                @if(weighted || confidence) let observation = observations[pixel_at];
                @if(weighted || confidence) let measured = observation.x;
                let eta = measured - p.z;
                if measured <= 0.0 || eta < -params.map.truncation_m {
                    continue;
                }
                let at = in_page * BLOCK_VOXELS + x + 8u * y + 64u * z;
                let voxel_before = distances[at];
                let old = unpack_distance(voxel_before);
                var weight = unpack_weight(voxel_before);
                // Seen through, but said to be near a surface: what stood there is gone.
                let gone = params.empty_loss > 0u && eta * per_mu >= 1.0 && old < NEARLY_EMPTY;
                @if(confidence) let before = f32(weight);
                weight -= min(select(0u, params.empty_loss, gone), weight);
                if params.stop_at_max_weight == 0u || weight < params.max_weight {
                    @if(!weighted) {
                        let fused = old + (min(eta * per_mu, 1.0) - old) / f32(weight + 1u);
                        distances[at] = pack_distance(fused, min(weight + 1u, params.max_weight));
                    }
                    @if(weighted) {
                        let more = u32(observation.y);
                        let fused = old + (min(eta * per_mu, 1.0) - old) * observation.y / f32(weight + more);
                        distances[at] = pack_distance(fused, min(weight + more, params.max_weight));
                    }
                }
                @if(confidence) {
                    // As if by so many of the best observations. What is taken back of the weight is taken back here too.
                    let kept = select(confidences[at] * f32(weight) / before, 0.0, before == 0.0);
                    confidences[at] = min(kept + observation.y / BEST_OBSERVATION, f32(params.max_weight));
                }
                @if(colour) {
                    if abs(eta * per_mu) <= params.colour_band {
                        near_surface[z >> 2u] |= 1u << ((y | (z << 3u)) & 31u);
                    }
                }
            }
        }
        // Colour in a loop of its own over the few voxels near the surface: a software driver would do its work for all
        // 64 of the column, masked, if it stood in the branch above.
        @if(colour) {
            while (near_surface.x | near_surface.y) != 0u {
                let upper = near_surface.x == 0u;
                let bits = select(near_surface.x, near_surface.y, upper);
                let k = firstTrailingBit(bits) + select(0u, 32u, upper);
                near_surface = select(
                    vec2(near_surface.x & (near_surface.x - 1u), near_surface.y),
                    vec2(near_surface.x, near_surface.y & (near_surface.y - 1u)),
                    upper,
                );
                fuse_colour(in_page * BLOCK_VOXELS + x + 8u * k, corner + vec3(0.0, f32(k & 7u), f32(k >> 3u)) * voxel);
            }
        }
    }
}
