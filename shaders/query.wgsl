// The signed distance at points anywhere, and its gradient: trilinear interpolation between the eight voxels around each, and
// the interpolant's own derivative. Blocks are found through the hash, for the points may lie outside of every view.
import package::shared::distance::{Voxel, load_distance_or_zero, unpack_distance, unpack_weight};
import package::shared::map::{Map, block_of, index_in_block, pack_key};
import package::shared::table::find_in_hash;

struct Params {
    map: Map,
    count: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
// World coordinates in metres.
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
// The gradient, and the distance in metres; UNSEEN in place of the distance where one of the eight voxels was never seen.
@group(0) @binding(2) var<storage, read_write> samples: array<vec4<f32>>;

const UNSEEN: f32 = 3e38;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count; i += groups.x * 64u) {
        samples[i] = sample(points[i].xyz / params.map.voxel_size_m);
    }
}

fn sample(position: vec3<f32>) -> vec4<f32> {
    let low = floor(position);
    let f = position - low;
    let base = vec3<i32>(low);
    let first = block_of(base);
    var distances: array<f32, 8>;
    // Most cells lie in one block, which is looked up once.
    let home = find_in_hash(params.map, pack_key(first, params.map.submap));
    for (var c = 0u; c < 8u; c++) {
        let voxel = base + vec3<i32>(vec3(c & 1u, (c >> 1u) & 1u, c >> 2u));
        let block = block_of(voxel);
        var found = home;
        if any(block != first) {
            found = find_in_hash(params.map, pack_key(block, params.map.submap));
        }
        let seen = load_distance_or_zero(params.map, found, index_in_block(voxel));
        if unpack_weight(seen) == 0u {
            return vec4(0.0, 0.0, 0.0, UNSEEN);
        }
        distances[c] = unpack_distance(seen);
    }
    let even = vec4(distances[0], distances[2], distances[4], distances[6]);
    let odd = vec4(distances[1], distances[3], distances[5], distances[7]);
    // Along x at (y, z) = (0, 0), (1, 0), (0, 1), (1, 1).
    let along_x = mix(even, odd, f.x);
    let slopes_x = odd - even;
    let along_y = mix(along_x.xz, along_x.yw, f.y);
    let slope_x = mix(mix(slopes_x.x, slopes_x.y, f.y), mix(slopes_x.z, slopes_x.w, f.y), f.z);
    let slope_y = mix(along_x.y - along_x.x, along_x.w - along_x.z, f.z);
    let slope = vec3(slope_x, slope_y, along_y.y - along_y.x);
    let band = params.map.truncation_m;
    return vec4(slope * (band / params.map.voxel_size_m), mix(along_y.x, along_y.y, f.z) * band);
}
