//! The blocks of a session, wherever they lie: on the device, in the host's store, or on the way between the two.

use std::collections::{BTreeMap, BTreeSet};

use itm_core::block::merge_blocks;
use itm_core::voxel::BlockKey;
use itm_gpu::hash::Hash;
use itm_gpu::swap::{Left, Swap};
use itm_gpu::{BlockMap, MapLayout};
use itm_io::block_store::BlockStore;

use crate::Error;
use crate::source::BlockSource;

/// All blocks of a session's map. Looking at them changes nothing.
#[derive(Debug)]
pub(crate) struct LiveMap<'a> {
    pub(crate) map: &'a BlockMap,
    pub(crate) hash: &'a Hash,
    pub(crate) stage: &'a Swap,
    pub(crate) store: &'a BlockStore,
    pub(crate) left: Vec<&'a Left>,
    pub(crate) max_weight: u16,
    /// Packed keys of the blocks on the device.
    pub(crate) on_device: BTreeSet<[u32; 2]>,
}

impl BlockSource for LiveMap<'_> {
    fn layout(&self) -> MapLayout {
        *self.map.layout()
    }

    fn keys(&self) -> Vec<BlockKey> {
        let mut packed = self.on_device.clone();
        packed.extend(self.store.keys().map(BlockKey::pack));
        packed.extend(self.left.iter().flat_map(|left| &left.keys).map(|key| key.pack()));
        packed.into_iter().map(BlockKey::unpack).collect()
    }

    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error> {
        let kind = self.map.layout().kind;
        let length = kind.block_words();
        words.fill(0);
        // What was stored is older than what is on its way, and that older than what is on the device.
        let mut places: BTreeMap<[u32; 2], usize> = BTreeMap::new();
        for (i, (key, block)) in keys.iter().zip(words.chunks_exact_mut(length)).enumerate() {
            places.insert(key.pack(), i);
            self.store.get(*key, block)?;
        }
        let mut merge = |i: usize, from: &[u32]| {
            merge_blocks(kind, &mut words[i * length..(i + 1) * length], from, self.max_weight);
        };
        for left in &self.left {
            for (key, block) in left.keys.iter().zip(left.words.chunks_exact(length)) {
                if let Some(i) = places.get(&key.pack()) {
                    merge(*i, block);
                }
            }
        }
        let on_device: Vec<usize> = (0..keys.len()).filter(|i| self.on_device.contains(&keys[*i].pack())).collect();
        let wanted: Vec<BlockKey> = on_device.iter().map(|i| keys[*i]).collect();
        let found = self.hash.look_up(self.map, &wanted)?;
        let (indices, which): (Vec<u32>, Vec<usize>) =
            found.into_iter().zip(on_device).filter_map(|(index, i)| Some((index?, i))).unzip();
        for (indices, which) in indices.chunks(1024).zip(which.chunks(1024)) {
            let blocks = self.stage.read(self.map, indices)?;
            for (block, i) in blocks.chunks_exact(length).zip(which) {
                merge(*i, block);
            }
        }
        Ok(())
    }
}
