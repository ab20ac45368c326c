// The discs of the surfels of one page that cells keep, as the camera sees them.
import package::shared::camera::Camera;
import package::shared::disc::{Disc, known_of, pixels_of_disc};
import package::shared::observation::radius_of;
import package::shared::surfel::{Attributes, place_of, rank_of_key, submap_of, unpack_normal, unpack_radius};

struct Params {
    camera: Camera,
    camera_from_world: mat4x4<f32>,
    first: u32,
    page: u32,
    // Cells of a row, of the grid, and to each side of the image.
    width: u32,
    cells: u32,
    border: u32,
    reach: f32,
    largest_px: f32,
    preferred: f32,
    // Radius of a pixel's disc at a depth of one metre.
    pixel_radius_per_m: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> kept: array<u32>;
@group(0) @binding(2) var<storage, read> listed: array<u32>;
@group(0) @binding(3) var<storage, read> places: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> attributes: array<Attributes>;
@group(0) @binding(5) var<storage, read_write> discs: array<Disc>;
// The bits of its confidence, and its colour.
@group(0) @binding(6) var<storage, read_write> looks: array<vec2<u32>>;
// How many discs reach beyond the pixels around their cells, and behind that those cells. In whatever order: the largest of keys is the same in any.
@group(0) @binding(7) var<storage, read_write> large: array<atomic<u32>>;
@if(combined) @group(0) @binding(8) var<storage, read> camera_from_submaps: array<mat4x4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var cell = id.x; cell < params.cells; cell += groups.x * 64u) {
        let key = kept[cell];
        if key == 0u {
            discs[cell].radius = 0.0;
            continue;
        }
        let index = listed[place_of(key)];
        let at = index - params.first;
        if index < params.first || at >= params.page {
            continue;
        }
        let place = places[at];
        let own = attributes[at];
        @if(!combined) let camera_from_surfel = params.camera_from_world;
        @if(combined) let camera_from_surfel = camera_from_submaps[submap_of(own.y)];
        let centre = (camera_from_surfel * vec4(place.xyz, 1.0)).xyz;
        let normal = (camera_from_surfel * vec4(unpack_normal(own.x), 0.0)).xyz;
        // None are smaller than what a pixel sees of a surface: from afar a cell's disc stands for all that lie there.
        let least = radius_of(params.pixel_radius_per_m, centre.z, normal.z);
        let radius = max(unpack_radius(own.y) * params.reach, least);
        let pixels = pixels_of_disc(params.camera, centre, normal, radius, params.largest_px);
        let middle = vec2(i32(cell % params.width), i32(cell / params.width)) - i32(params.border);
        let is_large = any(pixels.xy < middle - 1) || any(pixels.zw > middle + 2);
        if is_large {
            atomicStore(&large[1u + atomicAdd(&large[0], 1u)], cell);
        }
        discs[cell] = Disc(centre, radius, normal, known_of(rank_of_key(key), place.w >= params.preferred));
        looks[cell] = vec2(bitcast<u32>(place.w), own.w);
    }
}
