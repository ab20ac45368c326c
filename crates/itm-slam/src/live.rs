//! The blocks of a session, wherever they lie: on the device, in the host's store, or on the way between the two.

use std::collections::{BTreeMap, BTreeSet};

use itm_core::block::merge_blocks;
use itm_core::voxel::BlockKey;
use itm_gpu::hash::Hash;
use itm_gpu::swap::{Gather, Left};
use itm_gpu::{BlockMap, MapLayout};
use itm_io::block_store::BlockStore;

use crate::Error;
use crate::source::BlockSource;
use crate::swapping::Moved;

/// All blocks of a session's map. Looking at them changes nothing.
#[derive(Debug)]
pub(crate) struct LiveMap<'a> {
    pub(crate) map: &'a BlockMap,
    pub(crate) hash: &'a Hash,
    pub(crate) gather: &'a Gather,
    pub(crate) store: Option<&'a BlockStore>,
    /// Packed keys of blocks in the store that have come to the device, where they have been merged: they stay in the store
    /// until their frame's record is due.
    pub(crate) superseded: BTreeSet<[u32; 2]>,
    /// Blocks on their way to the store by their packed keys: which ones of what left.
    pub(crate) left: BTreeMap<[u32; 2], Vec<(&'a Left, usize)>>,
    pub(crate) max_weight: u16,
    /// Packed keys of the blocks on the device.
    pub(crate) on_device: BTreeSet<[u32; 2]>,
}

impl<'a> LiveMap<'a> {
    /// Takes in what a frame moved that is not settled yet.
    pub(crate) fn add(&mut self, moved: &'a Moved) {
        for (key, placed) in moved.places.iter().flat_map(|(keys, placed)| keys.iter().zip(placed)) {
            if *placed {
                self.superseded.insert(key.pack());
            }
        }
        if let Some(left) = &moved.left {
            self.add_left(left);
        }
    }

    /// Takes in blocks that left the device but are not in the store.
    pub(crate) fn add_left(&mut self, left: &'a Left) {
        for (index, key) in left.keys.iter().enumerate() {
            self.left.entry(key.pack()).or_default().push((left, index));
        }
    }

    /// Whether all blocks lie on the device, and nowhere else.
    pub(crate) fn is_on_device(&self) -> bool {
        self.left.is_empty() && self.store.is_none_or(BlockStore::is_empty)
    }

    /// Whether the host has a part of a block that the device has not.
    pub(crate) fn is_on_host(&self, key: BlockKey) -> bool {
        self.left.contains_key(&key.pack()) || self.stored(key).is_some()
    }

    /// The store, where it has a part of a block that the device has not.
    fn stored(&self, key: BlockKey) -> Option<&'a BlockStore> {
        self.store.filter(|store| store.contains(key) && !self.superseded.contains(&key.pack()))
    }
}

impl BlockSource for LiveMap<'_> {
    fn layout(&self) -> MapLayout {
        *self.map.layout()
    }

    fn keys(&self) -> Vec<BlockKey> {
        let mut packed = self.on_device.clone();
        packed.extend(self.store.iter().flat_map(|store| store.keys()).map(BlockKey::pack));
        packed.extend(self.left.keys());
        packed.into_iter().map(BlockKey::unpack).collect()
    }

    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error> {
        let kind = self.map.layout().kind;
        let length = kind.block_words();
        words.fill(0);
        // What was stored is older than what is on its way, and that older than what is on the device. A side without weight has
        // nothing to say, so that what comes first is merged into nothing.
        for (key, block) in keys.iter().zip(words.chunks_exact_mut(length)) {
            if let Some(store) = self.stored(*key) {
                store.get(*key, block)?;
            }
            for (left, index) in self.left.get(&key.pack()).into_iter().flatten() {
                let from = &left.words[index * length..(index + 1) * length];
                merge_blocks(kind, block, from, self.max_weight);
            }
        }
        let on_device: Vec<usize> = (0..keys.len()).filter(|i| self.on_device.contains(&keys[*i].pack())).collect();
        let wanted: Vec<BlockKey> = on_device.iter().map(|i| keys[*i]).collect();
        let found = self.hash.look_up(self.map, &wanted)?;
        let (indices, which): (Vec<u32>, Vec<usize>) =
            found.into_iter().zip(on_device).filter_map(|(index, i)| Some((index?, i))).unzip();
        let mut blocks = vec![0; indices.len().min(1024) * length];
        for (indices, which) in indices.chunks(1024).zip(which.chunks(1024)) {
            let blocks = &mut blocks[..indices.len() * length];
            self.gather.read(self.map, indices, blocks)?;
            for (block, i) in blocks.chunks_exact(length).zip(which) {
                merge_blocks(kind, &mut words[i * length..(i + 1) * length], block, self.max_weight);
            }
        }
        Ok(())
    }
}
