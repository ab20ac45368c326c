// Truncated signed distances. One word a voxel: the low half (1 - distance) / 2 as 16-bit fixed point, the high half the
// weight. With `f32` two words: 1 - distance in single precision, and the weight. Either way zeroed memory is space never
// seen. What a voxel looks like is known here alone.
import package::shared::map::{Map, BLOCK_VOXELS, block_of};
import package::shared::grid::find_in_grid;

@if(f32) alias Voxel = vec2<u32>;
@if(!f32) alias Voxel = u32;

@group(1) @binding(3) var<storage, read> distance0: array<Voxel>;
@if(pages2) @group(1) @binding(4) var<storage, read> distance1: array<Voxel>;
@if(pages3) @group(1) @binding(5) var<storage, read> distance2: array<Voxel>;
@if(pages4) @group(1) @binding(6) var<storage, read> distance3: array<Voxel>;

// Distances (in truncation bands) above this claim no surface.
const NEARLY_EMPTY: f32 = 0.95;

const STEP: f32 = 1.0 / 32767.5;

fn unpack_distance(voxel: Voxel) -> f32 {
    @if(f32) return 1.0 - bitcast<f32>(voxel.x);
    @if(!f32) return 1.0 - f32(voxel & 0xffffu) * STEP;
}

// The distance times a positive factor, by which it is exact for fixed-point numbers too: where only ratios of distances
// matter, so that close to a voxel the surface's place is rounded only once.
fn scaled_distance(voxel: Voxel) -> f32 {
    @if(f32) return 1.0 - bitcast<f32>(voxel.x);
    @if(!f32) return 32767.5 - f32(voxel & 0xffffu);
}

// 1 where the distance is negative, or else 0.
fn sign_bit(voxel: Voxel) -> u32 {
    @if(f32) return u32(bitcast<f32>(voxel.x) > 1.0);
    // The upper half of the fixed-point numbers are the negative distances.
    @if(!f32) return (voxel >> 15u) & 1u;
}

fn unpack_weight(voxel: Voxel) -> u32 {
    @if(f32) return voxel.y;
    @if(!f32) return voxel >> 16u;
}

fn pack_distance(distance: f32, weight: u32) -> Voxel {
    @if(f32) return vec2(bitcast<u32>(1.0 - clamp(distance, -1.0, 1.0)), weight);
    @if(!f32) return u32(round((1.0 - clamp(distance, -1.0, 1.0)) * 32767.5)) | (weight << 16u);
}

// A voxel by block index and index within the block.
fn load_distance(map: Map, block: u32, voxel: u32) -> Voxel {
    @if(pages2) {
        let page = block >> map.page_shift;
        let at = (block & ((1u << map.page_shift) - 1u)) * BLOCK_VOXELS + voxel;
        @if(pages4) { if page == 3u { return distance3[at]; } }
        @if(pages3) { if page == 2u { return distance2[at]; } }
        if page == 1u {
            return distance1[at];
        }
        return distance0[at];
    }
    @if(!pages2) {
        return distance0[block * BLOCK_VOXELS + voxel];
    }
}

// A voxel by its block's index plus one; zero (never seen) for a block that is not there.
fn load_distance_or_zero(map: Map, block: u32, voxel: u32) -> Voxel {
    return select(load_distance(map, max(block, 1u) - 1u, voxel), Voxel(), block == 0u);
}

// Trilinear interpolation at a position in voxel units: the distance, and the smallest weight of the eight voxels.
//
// The eight voxels lie in up to eight blocks. All eight are looked up, without a branch: eight reads of neighbouring
// cells cost less than the divergence that asking first would bring.
fn interpolate(map: Map, position: vec3<f32>) -> vec2<f32> {
    let low = floor(position);
    let f = position - low;
    let base = vec3<i32>(low);
    let next = base + vec3(1);
    let b = block_of(base);
    let n = block_of(next);
    let i = vec3<u32>(base & vec3(7)) * vec3(1u, 8u, 64u);
    let j = vec3<u32>(next & vec3(7)) * vec3(1u, 8u, 64u);
    let w000 = load_distance_or_zero(map, find_in_grid(map, b), i.x + i.y + i.z);
    let w100 = load_distance_or_zero(map, find_in_grid(map, vec3(n.x, b.y, b.z)), j.x + i.y + i.z);
    let w010 = load_distance_or_zero(map, find_in_grid(map, vec3(b.x, n.y, b.z)), i.x + j.y + i.z);
    let w110 = load_distance_or_zero(map, find_in_grid(map, vec3(n.x, n.y, b.z)), j.x + j.y + i.z);
    let w001 = load_distance_or_zero(map, find_in_grid(map, vec3(b.x, b.y, n.z)), i.x + i.y + j.z);
    let w101 = load_distance_or_zero(map, find_in_grid(map, vec3(n.x, b.y, n.z)), j.x + i.y + j.z);
    let w011 = load_distance_or_zero(map, find_in_grid(map, vec3(b.x, n.y, n.z)), i.x + j.y + j.z);
    let w111 = load_distance_or_zero(map, find_in_grid(map, n), j.x + j.y + j.z);
    let x00 = mix(unpack_distance(w000), unpack_distance(w100), f.x);
    let x10 = mix(unpack_distance(w010), unpack_distance(w110), f.x);
    let x01 = mix(unpack_distance(w001), unpack_distance(w101), f.x);
    let x11 = mix(unpack_distance(w011), unpack_distance(w111), f.x);
    let low_weights = min(
        min(unpack_weight(w000), unpack_weight(w100)),
        min(unpack_weight(w010), unpack_weight(w110)),
    );
    let high_weights = min(
        min(unpack_weight(w001), unpack_weight(w101)),
        min(unpack_weight(w011), unpack_weight(w111)),
    );
    return vec2(mix(mix(x00, x10, f.y), mix(x01, x11, f.y), f.z), f32(min(low_weights, high_weights)));
}
