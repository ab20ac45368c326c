// Casts a ray for each pixel and finds where it enters a surface (the report, section 3.4). Rays start and end where the
// range image says.
import package::shared::camera::{Camera, unproject};
import package::shared::distance::{Cache, no_cache, find_cached, load_distance, unpack_distance, unpack_weight, interpolate};
import package::shared::map::{Map, block_of, index_in_block};

struct Params {
    camera: Camera,
    world_from_camera: mat4x4<f32>,
    map: Map,
    range_size: vec2<u32>,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> ranges: array<u32>;
// World coordinates in metres, and one plus the smallest weight of the eight voxels around; all zero where the ray hits nothing.
@group(0) @binding(2) var<storage, read_write> points: array<vec4<f32>>;

// A hit's distance from the surface, in truncation bands, is at most this.
const LARGEST_REST: f32 = 0.25;

const SEARCH_BLOCK_COARSE: u32 = 0u;
const SEARCH_BLOCK_FINE: u32 = 1u;
const SEARCH_SURFACE: u32 = 2u;
const BEHIND_SURFACE: u32 = 3u;
const WRONG_SIDE: u32 = 4u;

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
    var t = near * stretch;
    let start = t;
    let end = far * stretch;
    // How far the fine search goes before it is given up for the coarse one.
    var fine_until = 0.0;
    var state = SEARCH_BLOCK_COARSE;
    var distance = 1.0;
    var cache = no_cache();
    while t < end {
        let p = origin + t * direction;
        let voxel = vec3<i32>(floor(p + 0.5));
        let block = find_cached(params.map, block_of(voxel), &cache);
        var step = band;
        if block == 0u {
            if state != SEARCH_BLOCK_FINE || t > fine_until {
                state = SEARCH_BLOCK_COARSE;
                step = 8.0;
            }
        } else if state == SEARCH_BLOCK_COARSE {
            // The step that led here may have jumped over the block's first voxels, or over another block's corner.
            state = SEARCH_BLOCK_FINE;
            fine_until = t;
            t = max(t - 8.0, start);
            continue;
        } else {
            let word = load_distance(params.map, block - 1u, index_in_block(voxel));
            if unpack_weight(word) == 0u {
                // Never seen: neither in front of a surface nor behind one.
                state = SEARCH_BLOCK_FINE;
                fine_until = t;
            } else {
                distance = unpack_distance(word);
                if distance <= 0.1 && distance >= -0.5 {
                    distance = interpolate(params.map, p, &cache).x;
                }
                if distance > 0.0 {
                    state = SEARCH_SURFACE;
                    step = max(distance * band, 1.0);
                } else if state == SEARCH_SURFACE {
                    state = BEHIND_SURFACE;
                    break;
                } else {
                    state = WRONG_SIDE;
                    fine_until = t;
                    step = max(-distance * band, 1.0);
                }
            }
        }
        t += step;
    }
    if state != BEHIND_SURFACE {
        return vec4(0.0);
    }
    // Two steps to the zero crossing.
    t += distance * band;
    var refined = interpolate(params.map, origin + t * direction, &cache);
    t += refined.x * band;
    let hit = origin + t * direction;
    refined = interpolate(params.map, hit, &cache);
    // Where one of the eight voxels was never seen, the crossing is a guess; where the steps did not lead to the surface, as
    // at an object's outline, where distances of front and side are mixed, there is none.
    if refined.y == 0.0 || abs(refined.x) > LARGEST_REST {
        return vec4(0.0);
    }
    return vec4(hit * params.map.voxel_size_m, refined.y + 1.0);
}
