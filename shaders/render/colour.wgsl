// The map's colour at each point of a raycast image: the mean of the eight voxels around, weighted trilinearly, over
// those that hold a colour.
import package::shared::map::{Map, BLOCK_VOXELS, block_of, index_in_block};
import package::shared::grid::find_in_grid;

struct Params {
    map: Map,
    size: vec2<u32>,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> image: array<u32>;
@group(0) @binding(3) var<storage, read> colour0: array<u32>;
@if(pages2) @group(0) @binding(4) var<storage, read> colour1: array<u32>;
@if(pages3) @group(0) @binding(5) var<storage, read> colour2: array<u32>;
@if(pages4) @group(0) @binding(6) var<storage, read> colour3: array<u32>;

fn load_colour(block: u32, voxel: u32) -> u32 {
    let at = (block & ((1u << params.map.page_shift) - 1u)) * BLOCK_VOXELS + voxel;
    @if(pages2) {
        let page = block >> params.map.page_shift;
        @if(pages4) { if page == 3u { return colour3[at]; } }
        @if(pages3) { if page == 2u { return colour2[at]; } }
        if page == 1u {
            return colour1[at];
        }
    }
    return colour0[at];
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let point = points[i];
        var colour = vec4(0.0);
        if point.w > 0.0 {
            let position = point.xyz / params.map.voxel_size_m;
            let base = vec3<i32>(floor(position));
            let f = position - floor(position);
            var sum = vec3(0.0);
            var weights = 0.0;
            for (var c = 0u; c < 8u; c++) {
                let offset = vec3(c & 1u, (c >> 1u) & 1u, c >> 2u);
                let voxel = base + vec3<i32>(offset);
                let block = find_in_grid(params.map, block_of(voxel));
                if block != 0u {
                    let word = load_colour(block - 1u, index_in_block(voxel));
                    if (word >> 24u) > 0u {
                        let share = select(1.0 - f, f, offset == vec3(1u));
                        // A little more than nothing, so that a point right on an uncoloured voxel has a colour too.
                        let w = share.x * share.y * share.z + 1e-4;
                        sum += w * unpack4x8unorm(word).rgb;
                        weights += w;
                    }
                }
            }
            if weights > 0.0 {
                colour = vec4(sum / weights, 1.0);
            }
        }
        image[i] = pack4x8unorm(colour);
    }
}
