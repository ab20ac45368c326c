// The map's colours: one word a voxel, red, green, blue and the weight.
import package::shared::map::{Map, BLOCK_VOXELS, block_of, index_in_block};
import package::shared::grid::find_in_grid;

@group(1) @binding(3) var<storage, read> colour0: array<u32>;
@if(pages2) @group(1) @binding(4) var<storage, read> colour1: array<u32>;
@if(pages3) @group(1) @binding(5) var<storage, read> colour2: array<u32>;
@if(pages4) @group(1) @binding(6) var<storage, read> colour3: array<u32>;

fn load_colour(map: Map, block: u32, voxel: u32) -> u32 {
    let at = (block & ((1u << map.page_shift) - 1u)) * BLOCK_VOXELS + voxel;
    @if(pages2) {
        let page = block >> map.page_shift;
        @if(pages4) { if page == 3u { return colour3[at]; } }
        @if(pages3) { if page == 2u { return colour2[at]; } }
        if page == 1u {
            return colour1[at];
        }
    }
    return colour0[at];
}

// The mean of the eight voxels around a point (world frame, metres), weighted trilinearly, over those that hold a colour;
// zero where none does.
fn colour_at(map: Map, point: vec3<f32>) -> vec4<f32> {
    let position = point / map.voxel_size_m;
    let base = vec3<i32>(floor(position));
    let f = position - floor(position);
    var sum = vec3(0.0);
    var weights = 0.0;
    for (var c = 0u; c < 8u; c++) {
        let offset = vec3(c & 1u, (c >> 1u) & 1u, c >> 2u);
        let voxel = base + vec3<i32>(offset);
        let block = find_in_grid(map, block_of(voxel));
        if block != 0u {
            let word = load_colour(map, block - 1u, index_in_block(voxel));
            if (word >> 24u) > 0u {
                let share = select(1.0 - f, f, offset == vec3(1u));
                // A little more than nothing, so that a point right on an uncoloured voxel has a colour too.
                let w = share.x * share.y * share.z + 1e-4;
                sum += w * unpack4x8unorm(word).rgb;
                weights += w;
            }
        }
    }
    return select(vec4(0.0), vec4(sum / max(weights, 1e-9), 1.0), weights > 0.0);
}
