// Makes surfels of one page of measurements without any, in the order of their pixels: first in free slots, then behind all others.
import package::shared::camera::Camera;
import package::shared::observation::{radius_of, sample_confidence};
import package::shared::surfel::{Attributes, USED, FREE, TAKEN, pack_normal, pack_size};

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    first: u32,
    page: u32,
    capacity: u32,
    frame: u32,
    chunks: u32,
    radius_per_m: f32,
    sigma: f32,
    submap: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> normals: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> colours: array<u32>;
// How many come before each 32 pixels, and behind those the pixels' bits.
@group(0) @binding(5) var<storage, read> wanted: array<u32>;
@group(0) @binding(6) var<storage, read> free: array<u32>;
@group(0) @binding(7) var<storage, read_write> places: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> attributes: array<Attributes>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let width = params.camera.size.x;
    let taken = counters[TAKEN];
    let available = counters[FREE] - taken;
    let used = counters[USED];
    for (var chunk = id.x; chunk < params.chunks; chunk += groups.x * 64u) {
        var rank = wanted[chunk];
        var bits = wanted[params.chunks + chunk];
        while bits != 0u {
            let i = chunk * 32u + firstTrailingBit(bits);
            bits &= bits - 1u;
            var index = used + rank - available;
            if rank < available {
                index = free[taken + rank];
            }
            rank += 1u;
            if index >= params.capacity || index < params.first || index - params.first >= params.page {
                continue;
            }
            let at = index - params.first;
            let vertex = vertices[i].xyz;
            let facing = normals[i].xyz;
            let share = sample_confidence(params.camera, vec2(i % width, i / width), params.sigma);
            let radius = radius_of(params.radius_per_m, vertex.z, facing.z);
            let colour = select(0u, (colours[i] & 0xffffffu) | (1u << 24u), (colours[i] >> 24u) != 0u);
            let normal = (params.world_from_camera * vec4(facing, 0.0)).xyz;
            places[at] = vec4((params.world_from_camera * vec4(vertex, 1.0)).xyz, share);
            attributes[at] = vec4(pack_normal(normal), pack_size(radius, params.submap), params.frame, colour);
        }
    }
}
