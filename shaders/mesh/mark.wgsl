// Marching cubes, first pass (Lorensen & Cline 1987): for each slice of 64 cells of a block, how many triangles it has,
// and a mark on each edge that one of them has a vertex on, wherever that edge's owner lies. A cell counts where all its
// eight corners were seen.
import package::shared::map::index_in_block;
import package::shared::padded::{PADDED_VOXELS, padded_index, neighbour_index};
import package::shared::edges::{EDGE_STRIDE, corner, edge_start};
import package::shared::distance::{unpack_distance, unpack_weight};

struct Params {
    first: u32,
    count: u32,
    min_weight: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> neighbours: array<u32>;
@group(0) @binding(2) var<storage, read> padded: array<u32>;
// 16 words a case: the number of triangles, then three cube edges for each.
@group(0) @binding(3) var<storage, read> cases: array<u32>;
@group(0) @binding(4) var<storage, read_write> edges: array<atomic<u32>>;
// One a block and slice.
@group(0) @binding(5) var<storage, read_write> triangle_counts: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * 8u; i += groups.x * 64u) {
        let block = i >> 3u;
        let z = i32(i & 7u);
        var triangles = 0u;
        // A block that is not in use has no neighbours, itself included.
        if neighbours[block * 27u + 13u] != 0u {
            for (var y = 0; y < 8; y++) {
                for (var x = 0; x < 8; x++) {
                    triangles += mark_cell(block, vec3(x, y, z));
                }
            }
        }
        triangle_counts[params.first * 8u + i] = triangles;
    }
}

fn mark_cell(block: u32, cell: vec3<i32>) -> u32 {
    var case_index = 0u;
    for (var c = 0u; c < 8u; c++) {
        let word = padded[block * PADDED_VOXELS + padded_index(cell + corner(c))];
        if unpack_weight(word) < params.min_weight {
            return 0u;
        }
        if unpack_distance(word) < 0.0 {
            case_index |= 1u << c;
        }
    }
    if case_index == 0u || case_index == 255u {
        return 0u;
    }
    let triangles = cases[case_index * 16u];
    var marked = 0u;
    for (var k = 0u; k < 3u * triangles; k++) {
        let e = cases[case_index * 16u + 1u + k];
        if (marked & (1u << e)) != 0u {
            continue;
        }
        marked |= 1u << e;
        let voxel = cell + edge_start(e);
        let owner = neighbours[block * 27u + neighbour_index(voxel >> vec3(3u))] - 1u;
        let bit = index_in_block(voxel) * 3u + (e >> 2u);
        atomicOr(&edges[owner * EDGE_STRIDE + (bit >> 5u)], 1u << (bit & 31u));
    }
    return triangles;
}
