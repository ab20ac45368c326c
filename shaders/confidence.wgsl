// Adds to a raycast image how well its points are known: a normal's fourth number becomes 2 plus the confidence of the voxel
// nearest to the point (see `integrate`), which tracking weighs the point by.
import package::shared::grid::find_in_grid;
import package::shared::map::{Map, block_of, index_in_block};
import package::shared::plane::load_word;

struct Params {
    map: Map,
    pixels: u32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> normals: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.pixels; i += groups.x * 64u) {
        if normals[i].w == 0.0 {
            continue;
        }
        let voxel = vec3<i32>(floor(points[i].xyz / params.map.voxel_size_m + 0.5));
        let block = find_in_grid(params.map, block_of(voxel));
        var confidence = 0.0;
        if block != 0u {
            confidence = bitcast<f32>(load_word(params.map, block - 1u, index_in_block(voxel)));
        }
        normals[i].w = 2.0 + confidence;
    }
}
