// Where blocks lie: keys, the hash of block indices, and the grid of block indices around the view.

const BLOCK_SIDE: i32 = 8;
const BLOCK_VOXELS: u32 = 512u;
// A hash slot that was never used, and one whose block was removed. Other slots hold a block's index plus one.
const EMPTY: u32 = 0u;
const TOMBSTONE: u32 = 0xffffffffu;
// The key of a block that is not in use (submap 65535 is reserved for it).
const NO_KEY: vec2<u32> = vec2(0xffffffffu, 0xffffffffu);
const OUTSIDE: u32 = 0xffffffffu;

// Indices into the counters, which the host reads as a frame's record.
const BLOCKS: u32 = 0u;
const FREE_BLOCKS: u32 = 1u;
const VISIBLE: u32 = 2u;
const REQUESTED: u32 = 3u;
const ALLOCATED: u32 = 4u;
const PENDING: u32 = 5u;
const FRAGMENTS: u32 = 6u;
const DROPPED: u32 = 7u;
const TOMBSTONES: u32 = 8u;

struct Map {
    // First block that the grid covers, and how many along each axis.
    grid_origin: vec3<i32>,
    hash_mask: u32,
    grid_size: vec3<u32>,
    submap: u32,
    voxel_size_m: f32,
    truncation_m: f32,
    // Blocks a page, as a power of two.
    page_shift: u32,
    // Blocks that the pools can hold.
    capacity: u32,
}

// Two words: x | y << 16 and z | submap << 16.
fn pack_key(position: vec3<i32>, submap: u32) -> vec2<u32> {
    let p = bitcast<vec3<u32>>(position) & vec3(0xffffu);
    return vec2(p.x | (p.y << 16u), p.z | (submap << 16u));
}

fn unpack_position(key: vec2<u32>) -> vec3<i32> {
    return vec3(
        extractBits(bitcast<i32>(key.x), 0u, 16u),
        extractBits(bitcast<i32>(key.x), 16u, 16u),
        extractBits(bitcast<i32>(key.y), 0u, 16u),
    );
}

// A finaliser in the manner of MurmurHash3 over both words: every bit of the key reaches the low bits.
fn hash_of(key: vec2<u32>) -> u32 {
    var h = (key.x * 0x9e3779b1u) ^ (key.y * 0x85ebca77u + 0x165667b1u);
    h = (h ^ (h >> 16u)) * 0x85ebca6bu;
    h = (h ^ (h >> 13u)) * 0xc2b2ae35u;
    return h ^ (h >> 16u);
}

// The block that a voxel belongs to.
fn block_of(voxel: vec3<i32>) -> vec3<i32> {
    return voxel >> vec3(3u);
}

// Index of a voxel within its block.
fn index_in_block(voxel: vec3<i32>) -> u32 {
    let v = bitcast<vec3<u32>>(voxel & vec3(7));
    return v.x | (v.y << 3u) | (v.z << 6u);
}

// The grid's cell for a block, or OUTSIDE.
fn cell_of(map: Map, block: vec3<i32>) -> u32 {
    let p = bitcast<vec3<u32>>(block - map.grid_origin);
    if any(p >= map.grid_size) {
        return OUTSIDE;
    }
    return p.x + map.grid_size.x * (p.y + map.grid_size.y * p.z);
}

// The block of a grid cell.
fn block_of_cell(map: Map, cell: u32) -> vec3<i32> {
    let x = cell % map.grid_size.x;
    let rest = cell / map.grid_size.x;
    return map.grid_origin + bitcast<vec3<i32>>(vec3(x, rest % map.grid_size.y, rest / map.grid_size.y));
}
