// Inserting into the hash and removing from it.
import package::shared::map::{Map, EMPTY, TOMBSTONE, hash_of};

@group(1) @binding(8) var<storage, read_write> slots: array<atomic<u32>>;

// Puts a block into the hash. Its key must not be there yet; then no two invocations insert equal keys, so that which
// of the free slots each gets does not matter to any look-up.
fn insert_into_hash(map: Map, key: vec2<u32>, block: u32) {
    var slot = hash_of(key) & map.hash_mask;
    loop {
        let seen = atomicLoad(&slots[slot]);
        if seen == EMPTY || seen == TOMBSTONE {
            if atomicCompareExchangeWeak(&slots[slot], seen, block + 1u).exchanged {
                return;
            }
            // Lost the slot to another invocation (or the exchange failed for no reason): look at it again.
            continue;
        }
        slot = (slot + 1u) & map.hash_mask;
    }
}

// Takes a block out of the hash; it must be there.
fn remove_from_hash(map: Map, key: vec2<u32>, block: u32) {
    var slot = hash_of(key) & map.hash_mask;
    loop {
        let seen = atomicLoad(&slots[slot]);
        if seen == block + 1u {
            atomicStore(&slots[slot], TOMBSTONE);
            return;
        }
        if seen == EMPTY {
            return;
        }
        slot = (slot + 1u) & map.hash_mask;
    }
}
