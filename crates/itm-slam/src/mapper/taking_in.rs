//! A map file's blocks become a session's.

use std::collections::{BTreeMap, BTreeSet};

use itm_core::block::merge_blocks;
use itm_core::voxel::BlockKey;
use itm_core::{MapIndex, Swapping};
use itm_gpu::HostBlock;
use itm_io::map_file::{MapReader, Tag};

use super::{Mapper, largest_weight};
use crate::Error;

/// Blocks that go to the device at once, and those that are read back at once to be merged with what arrives.
const AT_ONCE: usize = 16_384;
const MERGED_AT_ONCE: usize = 1024;

/// Blocks of a file on their way to the device.
#[derive(Default)]
struct Arriving {
    /// Packed; none is there twice.
    keys: BTreeSet<[u32; 2]>,
    /// Those that are not on the device.
    new: Vec<(BlockKey, Vec<u32>)>,
    /// Those of which a part is there, by its index.
    again: Vec<(u32, BlockKey, Vec<u32>)>,
}

impl Mapper {
    /// Takes blocks of a map file in: into the host's store, from where those near the view come to the device; or to the
    /// device, where none may leave it. Parts of one block, of which a file may have several, are merged. Returns how many found
    /// no place, because they lie outside of a dense map's box.
    pub(crate) fn take_in(&mut self, reader: &mut MapReader, section: Tag) -> Result<usize, Error> {
        self.extents = None;
        self.empty = false;
        if let Some(swapped) = self.swapped.as_mut().filter(|_| self.settings.map.swapping == Swapping::Host) {
            reader.blocks::<Error>(section, |key, words| match key {
                Some(key) => swapped.put(key, words),
                None => Ok(()),
            })?;
            return Ok(0);
        }
        let mut known = BTreeMap::new();
        for (key, index) in self.map.read_keys()?.into_iter().zip(0..) {
            known.extend(key.map(|key| (key.pack(), index)));
        }
        let dense = self.settings.map.index == MapIndex::Dense;
        let (mut next, mut outside) = (self.map.read_record()?.blocks, 0);
        let mut arriving = Arriving::default();
        reader.blocks::<Error>(section, |key, words| {
            let Some(key) = key else { return Ok(()) };
            if arriving.keys.contains(&key.pack())
                || arriving.new.len() == AT_ONCE
                || arriving.again.len() == MERGED_AT_ONCE
            {
                self.insert(&mut arriving)?;
            }
            match known.get(&key.pack()) {
                Some(index) => arriving.again.push((*index, key, words.to_vec())),
                None if dense => {
                    outside += 1;
                    return Ok(());
                }
                None => {
                    known.insert(key.pack(), next);
                    next += 1;
                    arriving.new.push((key, words.to_vec()));
                }
            }
            arriving.keys.insert(key.pack());
            Ok(())
        })?;
        self.insert(&mut arriving)?;
        Ok(outside)
    }

    fn insert(&mut self, arriving: &mut Arriving) -> Result<(), Error> {
        let Arriving { new, again, .. } = std::mem::take(arriving);
        if !new.is_empty() {
            let (wanted, limit) = (u64::from(self.map.read_record()?.blocks) + new.len() as u64, self.limit);
            if wanted > limit.into() {
                return Err(itm_gpu::Error::TooManyBlocks { wanted, limit }.into());
            }
            let blocks: Vec<_> = new.iter().map(|(key, words)| HostBlock { key: *key, words }).collect();
            self.map.insert_blocks(&blocks)?;
        }
        let kind = self.map.layout().kind;
        let indices: Vec<u32> = again.iter().map(|(index, ..)| *index).collect();
        let mut merged = vec![0; indices.len() * kind.block_words()];
        self.gather.read(&self.map, &indices, &mut merged)?;
        let merged = merged.chunks_exact_mut(kind.block_words());
        let mut blocks: Vec<(u32, HostBlock<'_>)> = Vec::new();
        for ((index, key, words), merged) in again.iter().zip(merged) {
            merge_blocks(kind, merged, words, largest_weight(&self.settings));
            blocks.push((*index, HostBlock { key: *key, words: merged }));
        }
        for run in blocks.chunk_by(|(before, _), (index, _)| before + 1 == *index) {
            let words: Vec<_> = run.iter().map(|(_, block)| *block).collect();
            self.map.write_blocks(run[0].0, &words);
        }
        Ok(())
    }
}
