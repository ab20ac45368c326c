// Marching cubes, second pass: the vertex on each marked edge of a range of blocks: position on the zero crossing,
// normal from the distances' gradient, colour.
import package::shared::map::unpack_position;
import package::shared::padded::{PADDED_VOXELS, padded_index};
import package::shared::edges::{EDGE_WORDS, EDGE_GROUPS, EDGE_STRIDE};
import package::shared::distance::{Voxel, scaled_distance, unpack_weight};

struct Params {
    first: u32,
    count: u32,
    // Number of the range's first vertex.
    first_vertex: u32,
    voxel_size_m: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> keys: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> edges: array<u32>;
@group(0) @binding(3) var<storage, read> vertex_offsets: array<u32>;
@group(0) @binding(4) var<storage, read> padded: array<Voxel>;
@if(colour) @group(0) @binding(5) var<storage, read> padded_colours: array<u32>;
@if(confidence) @group(0) @binding(7) var<storage, read> padded_confidences: array<f32>;
// Eight words a vertex: position (world, metres), colour (red, green, blue from the lowest byte up) with the edge in the highest
// byte (axis, and from bit 2 on the lowest three bits of where it starts along that axis), normal, and in one word weight (low half) and confidence (high half, in sixteenths, which are the least observations).
@group(0) @binding(6) var<storage, read_write> vertices: array<u32>;

fn voxel_at(block: u32, voxel: vec3<i32>) -> Voxel {
    return padded[block * PADDED_VOXELS + padded_index(voxel)];
}

// Derivative of the distance along an axis, from the neighbours that were seen.
fn slope(block: u32, voxel: vec3<i32>, axis: vec3<i32>, here: f32) -> f32 {
    let below = voxel_at(block, voxel - axis);
    let above = voxel_at(block, voxel + axis);
    let has_below = unpack_weight(below) > 0u;
    let has_above = unpack_weight(above) > 0u;
    if has_below && has_above {
        return 0.5 * (scaled_distance(above) - scaled_distance(below));
    }
    if has_above {
        return scaled_distance(above) - here;
    }
    return select(0.0, here - scaled_distance(below), has_below);
}

fn gradient(block: u32, voxel: vec3<i32>, here: f32) -> vec3<f32> {
    return vec3(
        slope(block, voxel, vec3(1, 0, 0), here),
        slope(block, voxel, vec3(0, 1, 0), here),
        slope(block, voxel, vec3(0, 0, 1), here),
    );
}

@if(colour) fn mixed_colour(block: u32, a: vec3<i32>, b: vec3<i32>, t: f32) -> u32 {
    let at = padded_colours[block * PADDED_VOXELS + padded_index(a)];
    let bt = padded_colours[block * PADDED_VOXELS + padded_index(b)];
    // Only voxels that hold a colour count. The surface never lies in a voxel itself, so that both shares are positive.
    let wa = select(0.0, 1.0 - t, (at >> 24u) > 0u);
    let wb = select(0.0, t, (bt >> 24u) > 0u);
    if wa + wb == 0.0 {
        return 0u;
    }
    let mixed = (unpack4x8unorm(at) * wa + unpack4x8unorm(bt) * wb) / (wa + wb);
    return pack4x8unorm(vec4(mixed.rgb, 0.0));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count * EDGE_GROUPS; i += groups.x * 64u) {
        let block = i / EDGE_GROUPS;
        let group = i % EDGE_GROUPS;
        let base = (params.first + block) * EDGE_STRIDE;
        let corner = unpack_position(keys[params.first + block]) * 8;
        var out = vertex_offsets[params.first + block] + edges[base + EDGE_WORDS + group] - params.first_vertex;
        for (var word = group * 8u; word < group * 8u + 8u; word++) {
            for (var bits = edges[base + word]; bits != 0u; bits &= bits - 1u) {
                write_vertex(block, corner, word * 32u + firstTrailingBit(bits), out);
                out += 1u;
            }
        }
    }
}

fn write_vertex(block: u32, corner: vec3<i32>, bit: u32, out: u32) {
    let index = bit & 511u;
    let axis = bit >> 9u;
    let a = vec3<i32>(vec3(index & 7u, (index >> 3u) & 7u, index >> 6u));
    let along = vec3<i32>(vec3(u32(axis == 0u), u32(axis == 1u), u32(axis == 2u)));
    let b = a + along;
    let voxel_a = voxel_at(block, a);
    let voxel_b = voxel_at(block, b);
    let da = scaled_distance(voxel_a);
    let db = scaled_distance(voxel_b);
    // The signs differ, so that the denominator is not zero.
    let t = da / (da - db);
    let position = (vec3<f32>(corner + a) + t * vec3<f32>(along)) * params.voxel_size_m;
    let slope_ab = mix(gradient(block, a, da), gradient(block, b, db), t);
    let steepness = length(slope_ab);
    let normal = select(vec3<f32>(along) * sign(db - da), slope_ab / steepness, steepness > 0.0);
    vertices[8u * out] = bitcast<u32>(position.x);
    vertices[8u * out + 1u] = bitcast<u32>(position.y);
    vertices[8u * out + 2u] = bitcast<u32>(position.z);
    var colour = 0u;
    @if(colour) { colour = mixed_colour(block, a, b, t); }
    vertices[8u * out + 3u] = colour | ((axis | (u32(dot(a, along)) << 2u)) << 24u);
    vertices[8u * out + 4u] = bitcast<u32>(normal.x);
    vertices[8u * out + 5u] = bitcast<u32>(normal.y);
    vertices[8u * out + 6u] = bitcast<u32>(normal.z);
    var weight = min(min(unpack_weight(voxel_a), unpack_weight(voxel_b)), 0xffffu);
    @if(confidence) {
        let confidence_a = padded_confidences[block * PADDED_VOXELS + padded_index(a)];
        let confidence_b = padded_confidences[block * PADDED_VOXELS + padded_index(b)];
        weight |= u32(min(16.0 * min(confidence_a, confidence_b) + 0.5, 65535.0)) << 16u;
    }
    vertices[8u * out + 7u] = weight;
}
