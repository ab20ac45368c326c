// Copies the voxels of those blocks of a range that have vertices, each with its neighbours' nearest layers, out of one
// page. Run once a page.
import package::shared::map::{BLOCK_VOXELS, index_in_block};
import package::shared::distance::Voxel;
import package::shared::padded::{PADDED_VOXELS, PADDED_SIDE, neighbour_index};

struct Params {
    first: u32,
    count: u32,
    page: u32,
    page_shift: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> neighbours: array<u32>;
@group(0) @binding(2) var<storage, read> vertex_offsets: array<u32>;
@group(0) @binding(3) var<storage, read> voxels: array<Voxel>;
@group(0) @binding(4) var<storage, read_write> padded: array<Voxel>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    // A row of eleven voxels an invocation.
    let rows = u32(PADDED_SIDE * PADDED_SIDE);
    for (var i = id.x; i < params.count * rows; i += groups.x * 64u) {
        let block = i / rows;
        if vertex_offsets[params.first + block] == vertex_offsets[params.first + block + 1u] {
            continue;
        }
        let y = i32(i % rows) % PADDED_SIDE - 1;
        let z = i32(i % rows) / PADDED_SIDE - 1;
        let out = block * PADDED_VOXELS + (i % rows) * u32(PADDED_SIDE);
        for (var x = -1; x <= 9; x++) {
            let voxel = vec3(x, y, z);
            let source = neighbours[block * 27u + neighbour_index(voxel >> vec3(3u))];
            var word = Voxel();
            if source != 0u {
                if ((source - 1u) >> params.page_shift) != params.page {
                    continue;
                }
                let in_page = (source - 1u) & ((1u << params.page_shift) - 1u);
                word = voxels[in_page * BLOCK_VOXELS + index_in_block(voxel)];
            }
            padded[out + u32(x + 1)] = word;
        }
    }
}
