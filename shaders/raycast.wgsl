// Casts a ray for each pixel and finds where it enters a surface (the report, section 3.4). Rays start and end where the
// range image says. With `listed`, only for the pixels of a list.
import package::shared::camera::{Camera, unproject};
import package::shared::distance::{load_distance_or_zero, unpack_distance, unpack_weight, interpolate};
import package::shared::grid::find_in_grid;
import package::shared::map::{Map, block_of, index_in_block};
@if(listed) import package::shared::pixels::{COUNT, FIRST};

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    map: Map,
    range_size: vec2<u32>,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> ranges: array<u32>;
// World coordinates in metres, and one plus the smallest weight of the eight voxels around the place from which the last
// refining step led there; all zero where the ray hits nothing.
@group(0) @binding(2) var<storage, read_write> points: array<vec4<f32>>;

// A hit's distance from the surface, in truncation bands, is at most this.
const LARGEST_REST: f32 = 0.25;

const SEARCH_BLOCK_COARSE: u32 = 0u;
const SEARCH_BLOCK_FINE: u32 = 1u;
const SEARCH_SURFACE: u32 = 2u;
const BEHIND_SURFACE: u32 = 3u;
const WRONG_SIDE: u32 = 4u;

@if(listed)
@group(0) @binding(8) var<storage, read> missing: array<u32>;

@if(listed)
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < missing[COUNT]; i += groups.x * 64u) {
        let pixel = missing[FIRST + i];
        points[pixel] = cast_ray(vec2(pixel % params.camera.size.x, pixel / params.camera.size.x));
    }
}

@if(!listed)
@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = params.camera.size;
    if id.x >= size.x || id.y >= size.y {
        return;
    }
    let pixel = id.y * size.x + id.x;
    points[pixel] = cast_ray(id.xy);
}

fn cast_ray(pixel: vec2<u32>) -> vec4<f32> {
    let range = 2u * ((pixel.y / 8u) * params.range_size.x + pixel.x / 8u);
    if ranges[range + 1u] == 0u {
        return vec4(0.0);
    }
    let near = max(bitcast<f32>(~ranges[range]), params.camera.depth_range.x);
    let far = bitcast<f32>(ranges[range + 1u]);

    // In voxel units along a unit direction from here on.
    let ray = unproject(params.camera, vec2<f32>(pixel), 1.0);
    let per_voxel = 1.0 / params.map.voxel_size_m;
    let stretch = length(ray) * per_voxel;
    let direction = (params.world_from_camera * vec4(ray / length(ray), 0.0)).xyz;
    let origin = params.world_from_camera[3].xyz * per_voxel;
    let band = params.map.truncation_m * per_voxel;
    let forward = direction > vec3(0.0);
    let inverse = 1.0 / select(direction, vec3(1e-12), abs(direction) < vec3(1e-12));
    var t = near * stretch;
    let end = far * stretch;
    var state = SEARCH_BLOCK_COARSE;
    var distance = 1.0;
    // Software drivers run both sides of every branch, so this loop looks up one block and one voxel, and nothing else:
    // interpolation waits for the refining steps.
    while t < end {
        let p = origin + t * direction + 0.5;
        let voxel = vec3<i32>(floor(p));
        let block = find_in_grid(params.map, block_of(voxel));
        let seen = load_distance_or_zero(params.map, block, index_in_block(voxel));
        distance = unpack_distance(seen);
        var step = band;
        if block == 0u {
            // A block at a time, exactly to its border: no step jumps over the next one's corner.
            state = SEARCH_BLOCK_COARSE;
            let corner = vec3<f32>(block_of(voxel) * 8);
            let border = (select(corner, corner + 8.0, forward) - p) * inverse;
            step = max(min(border.x, min(border.y, border.z)), 0.0) + 0.01;
        } else if unpack_weight(seen) == 0u {
            // Never seen: neither in front of a surface nor behind one.
            state = SEARCH_BLOCK_FINE;
        } else if distance > 0.0 {
            state = SEARCH_SURFACE;
            step = max(distance * band, 1.0);
        } else if state == SEARCH_SURFACE {
            state = BEHIND_SURFACE;
            break;
        } else {
            // Behind a surface without having been in front of it.
            state = WRONG_SIDE;
            step = max(-distance * band, 1.0);
        }
        t += step;
    }
    if state != BEHIND_SURFACE {
        return vec4(0.0);
    }
    // To the zero crossing: one step by the nearest voxel, two by interpolation.
    t += distance * band;
    t += interpolate(params.map, origin + t * direction).x * band;
    let refined = interpolate(params.map, origin + t * direction);
    // Where one of the eight voxels was never seen, the crossing is a guess; where the steps do not lead to the surface, as
    // at an object's outline, where distances of front and side are mixed, there is none.
    if refined.y == 0.0 || abs(refined.x) > LARGEST_REST {
        return vec4(0.0);
    }
    t += refined.x * band;
    let hit = origin + t * direction;
    return vec4(hit * params.map.voxel_size_m, refined.y + 1.0);
}
