//! A map's blocks in parts that fit the device, each with the blocks around it.

use std::collections::{HashMap, HashSet};

use glam::IVec3;
use itm_core::voxel::BlockKey;

/// Fewest blocks that a part with its surroundings may be bounded by: one and its 26 neighbours.
pub(crate) const LEAST_BLOCKS: u32 = 27;
/// Edge of the cells that parts are made of, in blocks, where the bound allows it.
const CELL_SIDE: i32 = 8;

/// Blocks in chunks, each of one submap.
#[derive(Debug)]
pub(crate) struct Chunks {
    /// All blocks, chunk by chunk.
    keys: Vec<BlockKey>,
    /// Where each chunk begins, and where the last one ends.
    starts: Vec<usize>,
    chunk_of: HashMap<[u32; 2], u32>,
    /// Blocks of no chunk, which only lie around those that are.
    around: HashSet<[u32; 2]>,
}

impl Chunks {
    /// Cuts blocks into chunks of at most so many blocks, their surroundings included ([`LEAST_BLOCKS`] where that is more).
    ///
    /// Cells of some blocks a side, along a Z-order curve (Morton 1966), which keeps neighbours together, go into a chunk
    /// until it is full. Which block goes where depends on the keys alone, and not on their order.
    pub(crate) fn new(keys: Vec<BlockKey>, max_blocks: u32) -> Self {
        Self::among(keys, HashSet::new(), max_blocks)
    }

    /// The same for some of a map's blocks, each named once; `others` are blocks that lie around them.
    pub(crate) fn among(mut keys: Vec<BlockKey>, others: HashSet<[u32; 2]>, max_blocks: u32) -> Self {
        let bound = max_blocks.max(LEAST_BLOCKS) as usize;
        let fits = |side: &i32| ((side + 2) as usize).pow(3) <= bound;
        let side = [CELL_SIDE, 4, 2].into_iter().find(fits).unwrap_or(1);
        let cell = |key: &BlockKey| (key.submap, along_curve(key.position.div_euclid(IVec3::splat(side))));
        keys.sort_by_cached_key(|key| (cell(key), key.position.to_array()));
        let mut chunk_of: HashMap<[u32; 2], u32> = keys.iter().map(|key| (key.pack(), 0)).collect();
        let (mut starts, mut at) = (Vec::new(), 0);
        // The chunk's blocks and those around them so far.
        let mut held: HashSet<[u32; 2]> = HashSet::new();
        for group in keys.chunk_by(|a, b| cell(a) == cell(b)) {
            let with_surroundings =
                || group.iter().flat_map(|key| around(*key)).filter(|k| chunk_of.contains_key(k) || others.contains(k));
            let more: HashSet<[u32; 2]> = with_surroundings().filter(|key| !held.contains(key)).collect();
            let begins = at == 0 || keys[at - 1].submap != group[0].submap || held.len() + more.len() > bound;
            if begins {
                starts.push(at);
                held = with_surroundings().collect();
            } else {
                held.extend(more);
            }
            for key in group {
                chunk_of.insert(key.pack(), starts.len() as u32 - 1);
            }
            at += group.len();
        }
        starts.push(at);
        Self { keys, starts, chunk_of, around: others }
    }

    /// Number of blocks.
    pub(crate) fn blocks(&self) -> usize {
        self.keys.len()
    }

    /// Number of chunks.
    pub(crate) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// A chunk's own blocks.
    pub(crate) fn own(&self, chunk: usize) -> &[BlockKey] {
        &self.keys[self.starts[chunk]..self.starts[chunk + 1]]
    }

    /// A chunk's own blocks, and then those around them.
    pub(crate) fn with_surroundings(&self, chunk: usize) -> Vec<BlockKey> {
        let mut all = self.own(chunk).to_vec();
        let mut seen: HashSet<[u32; 2]> = all.iter().map(|key| key.pack()).collect();
        for key in self.own(chunk) {
            let there = |key: &[u32; 2]| self.chunk_of.contains_key(key) || self.around.contains(key);
            let new = around(*key).filter(|key| there(key) && seen.insert(*key));
            all.extend(new.map(BlockKey::unpack));
        }
        all
    }

    /// The chunk that a block is an own one of.
    pub(crate) fn chunk_of(&self, key: BlockKey) -> Option<usize> {
        self.chunk_of.get(&key.pack()).map(|&chunk| chunk as usize)
    }
}

/// The packed keys of a block and its 26 neighbours, as far as there can be any.
pub(crate) fn around(key: BlockKey) -> impl Iterator<Item = [u32; 2]> {
    let side = || -1..=1;
    let offsets = side().flat_map(move |z| side().flat_map(move |y| side().map(move |x| IVec3::new(x, y, z))));
    let positions = offsets.map(move |offset| key.position + offset);
    let inside = |p: &IVec3| p.to_array().iter().all(|c| i16::try_from(*c).is_ok());
    positions.filter(inside).map(move |position| BlockKey { position, ..key }.pack())
}

/// Place along the Z-order curve: the bits of all three coordinates, interleaved.
fn along_curve(cell: IVec3) -> u64 {
    let bits = cell.to_array().map(|c| (c + (1 << 15)) as u64);
    (0..16).map(|bit| (0..3).map(|axis| (bits[axis] >> bit & 1) << (3 * bit + axis)).sum::<u64>()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bumpy surface of blocks in two submaps, one of them at the end of what keys can tell.
    fn surface() -> Vec<BlockKey> {
        let mut keys = Vec::new();
        for (submap, corner) in [(0, IVec3::new(-9, -13, 2)), (3, IVec3::splat(i16::MAX as i32 - 29))] {
            for i in 0..900 {
                let (x, y) = (i % 30, i / 30);
                keys.push(BlockKey { submap, position: corner + IVec3::new(x, y, (x * y / 37) % 5) });
            }
        }
        keys
    }

    #[test]
    fn every_block_is_the_own_one_of_one_chunk_and_has_its_neighbours_there() {
        let keys = surface();
        let all: HashSet<_> = keys.iter().map(|k| k.pack()).collect();
        for bound in [0, 27, 64, 200, 1000, 100_000] {
            let chunks = Chunks::new(keys.clone(), bound);
            let mut own = 0;
            for chunk in 0..chunks.len() {
                let blocks = chunks.with_surroundings(chunk);
                let count = chunks.own(chunk).len();
                own += count;
                assert_eq!(blocks[..count], *chunks.own(chunk));
                assert!(blocks.len() <= bound.max(LEAST_BLOCKS) as usize, "{} blocks for {bound}", blocks.len());
                assert!(blocks.iter().all(|k| k.submap == blocks[0].submap));
                let there: HashSet<_> = blocks.iter().map(|k| k.pack()).collect();
                assert_eq!(there.len(), blocks.len(), "none is there twice");
                for key in chunks.own(chunk) {
                    assert_eq!(chunks.chunk_of(*key), Some(chunk));
                    assert!(around(*key).all(|k| !all.contains(&k) || there.contains(&k)));
                }
            }
            assert_eq!(own, keys.len());
            assert!(bound < 100_000 || chunks.len() == 2, "one a submap where there is room");
        }
    }

    #[test]
    fn the_order_of_keys_does_not_matter() {
        let keys = surface();
        let reversed: Vec<_> = keys.iter().rev().copied().collect();
        let (a, b) = (Chunks::new(keys, 100), Chunks::new(reversed, 100));
        assert_eq!((a.keys, a.starts), (b.keys, b.starts));
        assert_eq!(Chunks::new(Vec::new(), 100).len(), 0);
    }
}
