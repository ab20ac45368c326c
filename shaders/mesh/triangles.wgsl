// Marching cubes, third pass: the triangles of a range of blocks, as indices of vertices over the whole mesh.
import package::shared::map::index_in_block;
import package::shared::padded::neighbour_index;
import package::shared::signs::{cell_rows, surface_cells, cell_case};
import package::shared::edges::{EDGE_WORDS, EDGE_STRIDE, edge_start};

struct Params {
    first: u32,
    count: u32,
    // Number of the range's first triangle.
    first_triangle: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;
@group(0) @binding(3) var<storage, read> cases: array<u32>;
@group(0) @binding(4) var<storage, read> edges: array<u32>;
@group(0) @binding(5) var<storage, read> vertex_offsets: array<u32>;
@group(0) @binding(6) var<storage, read> triangle_offsets: array<u32>;
// Three vertex numbers each.
@group(0) @binding(7) var<storage, read_write> triangles: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * 8u; i += groups.x * 64u) {
        let slice = params.first * 8u + i;
        if triangle_offsets[slice] == triangle_offsets[slice + 1u] {
            continue;
        }
        let block = i >> 3u;
        let z = i32(i & 7u);
        var out = 3u * (triangle_offsets[slice] - params.first_triangle);
        for (var y = 0; y < 8; y++) {
            let rows = cell_rows(block, y, z);
            for (var cells = surface_cells(rows); cells != 0u; cells &= cells - 1u) {
                let x = firstTrailingBit(cells);
                out = write_cell(block, vec3(i32(x), y, z), cell_case(rows, x) * 16u, out);
            }
        }
    }
}

// Writes a cell's triangles from `first` on, and returns where the next one's go.
fn write_cell(block: u32, cell: vec3<i32>, triangles_of_case: u32, first: u32) -> u32 {
    let indices = 3u * cases[triangles_of_case];
    for (var k = 0u; k < indices; k++) {
        let e = cases[triangles_of_case + 1u + k];
        triangles[first + k] = vertex_number(block, cell + edge_start(e), e >> 2u);
    }
    return first + indices;
}

// Number of the vertex on an edge of a voxel that may lie in a neighbouring block.
fn vertex_number(block: u32, voxel: vec3<i32>, axis: u32) -> u32 {
    let owner = neighbours[block * 27u + neighbour_index(voxel >> vec3(3u))] - 1u;
    let base = owner * EDGE_STRIDE;
    let bit = axis * 512u + index_in_block(voxel);
    let word = bit >> 5u;
    var rank = edges[base + EDGE_WORDS + (word >> 3u)];
    for (var i = word & ~7u; i < word; i++) {
        rank += countOneBits(edges[base + i]);
    }
    rank += countOneBits(edges[base + word] & ((1u << (bit & 31u)) - 1u));
    return vertex_offsets[owner] + rank;
}
