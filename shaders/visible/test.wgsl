// Tests blocks against the view's frustum: 32 blocks an invocation, one bit each, and how many of the bits are set.
import package::shared::map::{Map, BLOCKS, unpack_position};

struct Params {
    camera_from_world: mat4x4<f32>,
    // Inward unit normals of the frustum's four sides, through the camera's centre (camera frame).
    sides: array<vec4<f32>, 4>,
    map: Map,
    near_m: f32,
    far_m: f32,
    chunks: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read_write> bits: array<u32>;
@group(0) @binding(4) var<storage, read_write> counts: array<u32>;

fn is_visible(key: vec2<u32>) -> bool {
    if (key.y >> 16u) != params.map.submap {
        return false;
    }
    let voxel = params.map.voxel_size_m;
    let centre = (vec3<f32>(unpack_position(key)) * 8.0 + 3.5) * voxel;
    let p = (params.camera_from_world * vec4(centre, 1.0)).xyz;
    // The sphere around the block's 8x8x8 voxels.
    let radius = 3.5 * 1.7320509 * voxel;
    if p.z + radius < params.near_m || p.z - radius > params.far_m {
        return false;
    }
    for (var i = 0; i < 4; i++) {
        if dot(params.sides[i].xyz, p) < -radius {
            return false;
        }
    }
    return true;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.chunks {
        return;
    }
    let first = id.x * 32u;
    let last = min(first + 32u, counters[BLOCKS]);
    var mask = 0u;
    for (var block = first; block < last; block++) {
        if is_visible(keys[block]) {
            mask |= 1u << (block & 31u);
        }
    }
    bits[id.x] = mask;
    counts[id.x] = countOneBits(mask);
}
