// Fuses the arriving blocks' voxels with what the map holds at their places, one plane and page at a time: the mean of both by
// their weights. A block that was new is replaced. With no feature the plane is colours; with `distances` and
// `confidences` it is those.
import package::shared::distance::{Voxel, unpack_distance, unpack_weight, pack_distance};
import package::shared::map::BLOCK_VOXELS;

struct Params {
    count: u32,
    page: u32,
    page_shift: u32,
    // Where the plane starts within a transferred block, and how many words that has.
    plane_start: u32,
    block_words: u32,
    max_weight: u32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> places: array<u32>;
@group(0) @binding(2) var<storage, read> transfer: array<u32>;
@if(distances) @group(0) @binding(3) var<storage, read_write> voxels: array<Voxel>;
@if(!distances) @group(0) @binding(3) var<storage, read_write> voxels: array<u32>;

@if(distances) fn arriving(word: u32, index: u32) -> Voxel {
    @if(f32) return vec2(transfer[word + 2u * index], transfer[word + 2u * index + 1u]);
    @if(!f32) return transfer[word + index];
}

@if(distances) fn merged(a: Voxel, b: Voxel) -> Voxel {
    let weight_a = unpack_weight(a);
    let weight_b = unpack_weight(b);
    if weight_b == 0u {
        return a;
    }
    if weight_a == 0u {
        return b;
    }
    let sum = weight_a + weight_b;
    let share = f32(weight_b) / f32(sum);
    let distance = unpack_distance(a) + (unpack_distance(b) - unpack_distance(a)) * share;
    return pack_distance(distance, min(sum, params.max_weight));
}

@if(!distances) fn arriving(word: u32, index: u32) -> u32 {
    return transfer[word + index];
}

@if(!distances && confidences) fn merged(a: u32, b: u32) -> u32 {
    if b == 0u {
        return a;
    }
    if a == 0u {
        return b;
    }
    return bitcast<u32>(min(bitcast<f32>(a) + bitcast<f32>(b), f32(params.max_weight)));
}

@if(!distances && !confidences) fn merged(a: u32, b: u32) -> u32 {
    let weight_a = a >> 24u;
    let weight_b = b >> 24u;
    if weight_b == 0u {
        return a;
    }
    if weight_a == 0u {
        return b;
    }
    let sum = weight_a + weight_b;
    var word = min(sum, min(params.max_weight, 255u)) << 24u;
    for (var shift = 0u; shift < 24u; shift += 8u) {
        // In whole numbers, halves upwards.
        let mean = (((a >> shift) & 255u) * weight_a + ((b >> shift) & 255u) * weight_b + sum / 2u) / sum;
        word |= mean << shift;
    }
    return word;
}

@compute @workgroup_size(64)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    for (var i = group.x; i < params.count; i += groups.x) {
        let block = places[i] - 1u;
        if places[i] != 0u && (block >> params.page_shift) == params.page {
            let first = (block & ((1u << params.page_shift) - 1u)) * BLOCK_VOXELS;
            let word = i * params.block_words + params.plane_start;
            for (var voxel = lane; voxel < BLOCK_VOXELS; voxel += 64u) {
                voxels[first + voxel] = merged(voxels[first + voxel], arriving(word, voxel));
            }
        }
    }
}
