// Marching cubes, first pass (Lorensen & Cline 1987): for each slice of 64 cells of a block, how many triangles it has,
// and which of the edges that the slice's voxels own bear a vertex. A cell counts where all its eight corners were seen;
// an edge bears a vertex where the signs of its ends differ and one of the four cells around it counts. Only cells of the
// first `cells_of` blocks count; the others lend their voxels.
import package::shared::signs::{cell_rows, seen_cells, surface_cells, cell_case};
import package::shared::edges::EDGE_STRIDE;
import package::shared::padded::neighbour_index;

struct Params {
    first: u32,
    count: u32,
    cells_of: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
// 16 words a case: the number of triangles, then three cube edges for each.
@group(0) @binding(2) var<storage, read> cases: array<u32>;
@group(0) @binding(3) var<storage, read_write> edges: array<u32>;
// One a block and slice.
@group(0) @binding(4) var<storage, read_write> triangle_counts: array<u32>;
@group(0) @binding(5) var<storage, read> neighbours: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * 8u; i += groups.x * 64u) {
        let block = i >> 3u;
        let z = i32(i & 7u);
        var triangles = 0u;
        // Four rows of eight bits make a word.
        for (var half = 0; half < 2; half++) {
            var marks = vec3(0u);
            for (var y = 4 * half; y < 4 * half + 4; y++) {
                let rows = cell_rows(block, y, z);
                marks |= marked_edges(block, y, z, rows) << vec3(8u * u32(y & 3));
                for (var cells = surface_cells(rows) & (own_cells(block, y, z) >> 1u); cells != 0u; cells &= cells - 1u) {
                    triangles += cases[cell_case(rows, firstTrailingBit(cells)) * 16u];
                }
            }
            let out = (params.first + block) * EDGE_STRIDE + 2u * u32(z) + u32(half);
            edges[out] = marks.x;
            edges[out + 16u] = marks.y;
            edges[out + 32u] = marks.z;
        }
        triangle_counts[params.first * 8u + i] = triangles;
    }
}

// Bit x + 1 for each cell, x from -1 to 7, of the row at y and z (-1 to 7) that belongs to one of the first blocks. A cell of a
// block that is not there was not seen anyway.
fn own_cells(block: u32, y: i32, z: i32) -> u32 {
    let n = block * 27u + neighbour_index(vec3(0, y >> 3u, z >> 3u));
    // Zero, for a block that is not there, becomes the largest number.
    let before = select(0u, 1u, neighbours[n - 1u] - 1u < params.cells_of);
    return before | select(0u, 0x1feu, neighbours[n] - 1u < params.cells_of);
}

// The cells of a row that count.
fn counted_cells(block: u32, y: i32, z: i32, rows: vec4<u32>) -> u32 {
    return seen_cells(rows) & own_cells(block, y, z);
}

// For each axis bit x, x from 0 to 7, where the voxel's edge along that axis bears a vertex.
fn marked_edges(block: u32, y: i32, z: i32, rows: vec4<u32>) -> vec3<u32> {
    let seen = counted_cells(block, y, z, rows);
    let seen_y = counted_cells(block, y - 1, z, cell_rows(block, y - 1, z));
    let seen_z = counted_cells(block, y, z - 1, cell_rows(block, y, z - 1));
    let seen_yz = counted_cells(block, y - 1, z - 1, cell_rows(block, y - 1, z - 1));
    // The cells on both sides along x: x - 1 and x.
    let around_y = seen | seen_z;
    let around_z = seen | seen_y;
    let marks = vec3(
        (rows.x ^ (rows.x >> 1u)) & (around_y | seen_y | seen_yz),
        (rows.x ^ rows.y) & (around_y | (around_y << 1u)),
        (rows.x ^ rows.z) & (around_z | (around_z << 1u)),
    );
    return (marks >> vec3(1u)) & vec3(0xffu);
}
