// Truncated signed distances: one word a voxel, the low half (1 - distance) / 2 as 16-bit fixed point, the high half the
// weight, so that zeroed memory is space never seen.
import package::shared::map::{Map, BLOCK_VOXELS, block_of, index_in_block};
import package::shared::table::find_block;

@group(1) @binding(3) var<storage, read> distance0: array<u32>;
@if(pages2) @group(1) @binding(4) var<storage, read> distance1: array<u32>;
@if(pages3) @group(1) @binding(5) var<storage, read> distance2: array<u32>;
@if(pages4) @group(1) @binding(6) var<storage, read> distance3: array<u32>;

const STEP: f32 = 1.0 / 32767.5;

fn unpack_distance(word: u32) -> f32 {
    return 1.0 - f32(word & 0xffffu) * STEP;
}

fn unpack_weight(word: u32) -> u32 {
    return word >> 16u;
}

fn pack_distance(distance: f32, weight: u32) -> u32 {
    return u32(round((1.0 - clamp(distance, -1.0, 1.0)) * 32767.5)) | (weight << 16u);
}

// A voxel's word by block index and index within the block.
fn load_distance(map: Map, block: u32, voxel: u32) -> u32 {
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

// The last block looked up: neighbouring reads along a ray mostly stay in it.
struct Cache {
    position: vec3<i32>,
    // Index plus one, or zero for a block that is not there.
    block: u32,
}

fn no_cache() -> Cache {
    return Cache(vec3(i32(0x7fffffff)), 0u);
}

fn find_cached(map: Map, position: vec3<i32>, cache: ptr<function, Cache>) -> u32 {
    if any((*cache).position != position) {
        *cache = Cache(position, find_block(map, position));
    }
    return (*cache).block;
}

// A voxel's word, or zero (never seen) where its block is not there.
fn read_voxel(map: Map, voxel: vec3<i32>, cache: ptr<function, Cache>) -> u32 {
    let block = find_cached(map, block_of(voxel), cache);
    if block == 0u {
        return 0u;
    }
    return load_distance(map, block - 1u, index_in_block(voxel));
}

// Trilinear interpolation at a position in voxel units: the distance, and the smallest weight of the eight voxels.
fn interpolate(map: Map, position: vec3<f32>, cache: ptr<function, Cache>) -> vec2<f32> {
    let base = vec3<i32>(floor(position));
    let f = position - floor(position);
    let local = base & vec3(7);
    var w: array<u32, 8>;
    if all(local < vec3(7)) {
        let block = find_cached(map, block_of(base), cache);
        if block == 0u {
            return vec2(1.0, 0.0);
        }
        let at = index_in_block(base);
        w[0] = load_distance(map, block - 1u, at);
        w[1] = load_distance(map, block - 1u, at + 1u);
        w[2] = load_distance(map, block - 1u, at + 8u);
        w[3] = load_distance(map, block - 1u, at + 9u);
        w[4] = load_distance(map, block - 1u, at + 64u);
        w[5] = load_distance(map, block - 1u, at + 65u);
        w[6] = load_distance(map, block - 1u, at + 72u);
        w[7] = load_distance(map, block - 1u, at + 73u);
    } else {
        w[0] = read_voxel(map, base, cache);
        w[1] = read_voxel(map, base + vec3(1, 0, 0), cache);
        w[2] = read_voxel(map, base + vec3(0, 1, 0), cache);
        w[3] = read_voxel(map, base + vec3(1, 1, 0), cache);
        w[4] = read_voxel(map, base + vec3(0, 0, 1), cache);
        w[5] = read_voxel(map, base + vec3(1, 0, 1), cache);
        w[6] = read_voxel(map, base + vec3(0, 1, 1), cache);
        w[7] = read_voxel(map, base + vec3(1, 1, 1), cache);
    }
    let x00 = mix(unpack_distance(w[0]), unpack_distance(w[1]), f.x);
    let x10 = mix(unpack_distance(w[2]), unpack_distance(w[3]), f.x);
    let x01 = mix(unpack_distance(w[4]), unpack_distance(w[5]), f.x);
    let x11 = mix(unpack_distance(w[6]), unpack_distance(w[7]), f.x);
    let weight = min(min(min(w[0], w[1]), min(w[2], w[3])), min(min(w[4], w[5]), min(w[6], w[7]))) >> 16u;
    return vec2(mix(mix(x00, x10, f.y), mix(x01, x11, f.y), f.z), f32(weight));
}
