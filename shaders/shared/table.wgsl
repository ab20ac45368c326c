// Looking blocks up in the hash.
import package::shared::map::{Map, EMPTY, hash_of};

@group(1) @binding(0) var<storage, read> keys: array<vec2<u32>>;
@group(1) @binding(1) var<storage, read> hash: array<u32>;

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
