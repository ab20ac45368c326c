// What each pixel shows of the surfels of one page: the point where its ray meets the disc, and the disc's normal and colour.
import package::shared::camera::{Camera, unproject};
import package::shared::surfel::{Attributes, place_of, submap_of, unpack_normal};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    world_from_camera: mat4x4<f32>,
    first: u32,
    page: u32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> chosen: array<u32>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> attributes: array<Attributes>;
// World coordinates in metres, and one plus the surfel's confidence; all zero where nothing is seen.
@group(0) @binding(5) var<storage, read_write> points: array<vec4<f32>>;
// In the world's frame, towards the camera; the fourth number is 1.
@group(0) @binding(6) var<storage, read_write> normals: array<vec4<f32>>;
// Red, green, blue from the lowest byte up, and 255; 0 where the surfel has none.
@group(0) @binding(7) var<storage, read_write> colours: array<u32>;
@if(combined) @group(0) @binding(8) var<storage, read> camera_from_submaps: array<mat4x4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let width = params.camera.size.x;
    let pixels = width * params.camera.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        if chosen[i] == 0u {
            if params.first == 0u {
                points[i] = vec4(0.0);
                normals[i] = vec4(0.0);
                colours[i] = 0u;
            }
            continue;
        }
        let index = listed[place_of(chosen[i])];
        if index < params.first || index - params.first >= params.page {
            continue;
        }
        let place = places[index - params.first];
        let own = attributes[index - params.first];
        @if(!combined) let camera_from_surfel = params.camera_from_world;
        @if(combined) let camera_from_surfel = camera_from_submaps[submap_of(own.y)];
        let centre = (camera_from_surfel * vec4(place.xyz, 1.0)).xyz;
        let normal = (camera_from_surfel * vec4(unpack_normal(own.x), 0.0)).xyz;
        let ray = unproject(params.camera, vec2(f32(i % width), f32(i / width)), 1.0);
        let hit = ray * (dot(normal, centre) / dot(normal, ray));
        points[i] = vec4((params.world_from_camera * vec4(hit, 1.0)).xyz, place.w + 1.0);
        normals[i] = vec4((params.world_from_camera * vec4(normal, 0.0)).xyz, 1.0);
        colours[i] = select(0u, own.w | 0xff000000u, (own.w >> 24u) != 0u);
    }
}
