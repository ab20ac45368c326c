// What each pixel shows: the point where its ray meets the plane of the disc, and the disc's normal and colour.
import package::shared::camera::{Camera, unproject};
import package::shared::disc::Disc;
import package::shared::surfel::place_of;

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    // Of the image that these rows are a part of.
    first_pixel: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> chosen: array<u32>;
@group(0) @binding(2) var<storage, read> discs: array<Disc>;
@group(0) @binding(3) var<storage, read> looks: array<vec2<u32>>;
// World coordinates in metres, and one plus the surfel's confidence; all zero where nothing is seen.
@group(0) @binding(4) var<storage, read_write> points: array<vec4<f32>>;
// In the world's frame, towards the camera; the fourth number is 1.
@group(0) @binding(5) var<storage, read_write> normals: array<vec4<f32>>;
// Red, green, blue from the lowest byte up, and 255; 0 where the surfel has none.
@group(0) @binding(6) var<storage, read_write> colours: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let width = params.camera.size.x;
    let pixels = width * params.camera.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let to = params.first_pixel + i;
        if chosen[i] == 0u {
            points[to] = vec4(0.0);
            normals[to] = vec4(0.0);
            colours[to] = 0u;
            continue;
        }
        let cell = place_of(chosen[i]);
        let disc = discs[cell];
        let look = looks[cell];
        let ray = unproject(params.camera, vec2(f32(i % width), f32(i / width)), 1.0);
        let hit = ray * (dot(disc.normal, disc.centre) / dot(disc.normal, ray));
        points[to] = vec4((params.world_from_camera * vec4(hit, 1.0)).xyz, bitcast<f32>(look.x) + 1.0);
        normals[to] = vec4((params.world_from_camera * vec4(disc.normal, 0.0)).xyz, 1.0);
        colours[to] = select(0u, look.y | 0xff000000u, (look.y >> 24u) != 0u);
    }
}
