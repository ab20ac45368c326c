// Marks those visible blocks of one page that hold nothing: no voxel that was seen near a surface, or behind one.
import package::shared::distance::{Voxel, NEARLY_EMPTY, unpack_distance, unpack_weight};
import package::shared::map::{VISIBLE, BLOCK_VOXELS};

struct Params {
    page: u32,
    page_shift: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> visible: array<u32>;
@group(0) @binding(3) var<storage, read> distances: array<Voxel>;
@group(0) @binding(4) var<storage, read_write> bits: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < counters[VISIBLE]; i += groups.x * 64u) {
        let block = visible[i];
        if (block >> params.page_shift) != params.page {
            continue;
        }
        let first = (block & ((1u << params.page_shift) - 1u)) * BLOCK_VOXELS;
        var voxel = 0u;
        while voxel < BLOCK_VOXELS {
            let seen = distances[first + voxel];
            if unpack_weight(seen) > 0u && unpack_distance(seen) < NEARLY_EMPTY {
                break;
            }
            voxel += 1u;
        }
        if voxel == BLOCK_VOXELS {
            atomicOr(&bits[block >> 5u], 1u << (block & 31u));
        }
    }
}
