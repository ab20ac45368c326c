//! Reference of stage `hash`. The map itself needs none, being an ordinary hash map; tests that want colliding keys need
//! to know where keys go.

use itm_core::voxel::BlockKey;

/// The hash of a block's key: both words mixed by odd multipliers, then the finaliser of MurmurHash3 (Appleby 2011). A
/// table of 2ⁿ slots starts looking in the slot of its lowest n bits.
pub fn hash_of(key: BlockKey) -> u32 {
    let [a, b] = key.pack();
    let mut h = a.wrapping_mul(0x9e37_79b1) ^ b.wrapping_mul(0x85eb_ca77).wrapping_add(0x1656_67b1);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

#[cfg(test)]
mod tests {
    use glam::IVec3;

    use super::*;

    #[test]
    fn the_keys_of_a_surface_spread_evenly() {
        // A wall of 64x64 blocks in 16384 slots: evenly spread keys share slots as a Poisson distribution of mean 1/4
        // says, which leaves 4096 - 16384 (1 - exp(-1/4)) = 472 keys for slots that are taken.
        let mut slots = vec![0; 16_384];
        for i in 0..4096 {
            let position = IVec3::new(i % 64 - 32, i / 64 - 32, 17);
            slots[(hash_of(BlockKey { submap: 0, position }) & 16_383) as usize] += 1;
        }
        let sharing: i32 = slots.iter().map(|n: &i32| (n - 1).max(0)).sum();
        // The standard deviation is about 20.
        assert!((372..572).contains(&sharing), "{sharing} keys share a slot");
    }
}
