// Marching cubes, third pass: the triangles of a range of blocks, as indices of vertices over the whole mesh.
import package::shared::map::index_in_block;
import package::shared::padded::{PADDED_VOXELS, padded_index, neighbour_index};
import package::shared::edges::{EDGE_WORDS, EDGE_STRIDE, corner, edge_start};
import package::shared::distance::{unpack_distance, unpack_weight};

struct Params {
    first: u32,
    count: u32,
    min_weight: u32,
    // Number of the range's first triangle.
    first_triangle: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> neighbours: array<u32>;
@group(0) @binding(2) var<storage, read> padded: array<u32>;
@group(0) @binding(3) var<storage, read> cases: array<u32>;
@group(0) @binding(4) var<storage, read> edges: array<u32>;
@group(0) @binding(5) var<storage, read> vertex_offsets: array<u32>;
@group(0) @binding(6) var<storage, read> triangle_offsets: array<u32>;
// Three vertex numbers each.
@group(0) @binding(7) var<storage, read_write> triangles: array<u32>;

// Number of the vertex on an edge of a voxel that may lie in a neighbouring block.
fn vertex_number(block: u32, voxel: vec3<i32>, axis: u32) -> u32 {
    let owner = neighbours[block * 27u + neighbour_index(voxel >> vec3(3u))] - 1u;
    let base = owner * EDGE_STRIDE;
    let bit = index_in_block(voxel) * 3u + axis;
    let word = bit >> 5u;
    var rank = edges[base + EDGE_WORDS + (word >> 3u)];
    for (var i = word & ~7u; i < word; i++) {
        rank += countOneBits(edges[base + i]);
    }
    rank += countOneBits(edges[base + word] & ((1u << (bit & 31u)) - 1u));
    return vertex_offsets[owner] + rank;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * 8u; i += groups.x * 64u) {
        let block = i >> 3u;
        if neighbours[block * 27u + 13u] == 0u {
            continue;
        }
        var out = 3u * (triangle_offsets[params.first * 8u + i] - params.first_triangle);
        for (var y = 0; y < 8; y++) {
            for (var x = 0; x < 8; x++) {
                out = write_cell(block, vec3(x, y, i32(i & 7u)), out);
            }
        }
    }
}

fn write_cell(block: u32, cell: vec3<i32>, first: u32) -> u32 {
    var case_index = 0u;
    for (var c = 0u; c < 8u; c++) {
        let word = padded[block * PADDED_VOXELS + padded_index(cell + corner(c))];
        if unpack_weight(word) < params.min_weight {
            return first;
        }
        if unpack_distance(word) < 0.0 {
            case_index |= 1u << c;
        }
    }
    if case_index == 0u || case_index == 255u {
        return first;
    }
    let indices = 3u * cases[case_index * 16u];
    for (var k = 0u; k < indices; k++) {
        let e = cases[case_index * 16u + 1u + k];
        triangles[first + k] = vertex_number(block, cell + edge_start(e), e >> 2u);
    }
    return first + indices;
}
