// The map's colours: one word a voxel, red, green, blue and the weight.
import package::shared::grid::find_in_grid;
import package::shared::map::{Map, block_of, index_in_block};
import package::shared::plane::load_word;

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
            let word = load_word(map, block - 1u, index_in_block(voxel));
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
