// Looking blocks up.
import package::shared::map::{Map, EMPTY, OUTSIDE, pack_key, hash_of, cell_of};

@group(1) @binding(0) var<storage, read> keys: array<vec2<u32>>;
@group(1) @binding(1) var<storage, read> hash: array<u32>;
@group(1) @binding(2) var<storage, read> grid: array<u32>;

// A block's index plus one from the hash, or zero. Tombstones, being larger than any index, are walked over.
fn find_in_hash(map: Map, key: vec2<u32>) -> u32 {
    var slot = hash_of(key) & map.hash_mask;
    var entry = hash[slot];
    while entry != EMPTY {
        if entry <= map.capacity && all(keys[entry - 1u] == key) {
            return entry;
        }
        slot = (slot + 1u) & map.hash_mask;
        entry = hash[slot];
    }
    return 0u;
}

// A block's index plus one, or zero: from the grid where it covers the block, else from the hash.
fn find_block(map: Map, block: vec3<i32>) -> u32 {
    let cell = cell_of(map, block);
    if cell != OUTSIDE {
        return grid[cell];
    }
    return find_in_hash(map, pack_key(block, map.submap));
}
