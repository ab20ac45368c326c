//! Where a map's blocks come from, when not all of them lie on the device.

use std::collections::HashSet;

use itm_core::voxel::BlockKey;
use itm_gpu::{BlockMap, HostBlock, MapLayout};

use crate::Error;

/// Blocks that can be asked for: a saved map's, or those of a session, on the device and in the host's store.
pub trait BlockSource {
    /// What the map is made of.
    fn layout(&self) -> MapLayout;

    /// The keys of all blocks, each once, in any order that repeats.
    fn keys(&self) -> Vec<BlockKey>;

    /// Copies blocks out, one behind the other, each of [`itm_core::voxel::VoxelKind::block_words`] words. All keys are among
    /// [`BlockSource::keys`], and `words` is as long as they need.
    ///
    /// # Errors
    /// Where they cannot be read.
    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error>;
}

/// Blocks that are read and passed on at a time.
pub(crate) const AT_A_TIME: usize = 4096;

/// Puts blocks of a source into a map on the device, in their order, as blocks of the map's own submap. None may be there.
pub(crate) fn upload(source: &mut dyn BlockSource, keys: &[BlockKey], map: &mut BlockMap) -> Result<(), Error> {
    if keys.is_empty() {
        return Ok(());
    }
    let block_words = map.layout().kind.block_words();
    let mut words = vec![0; keys.len().min(AT_A_TIME) * block_words];
    // Once, so that pools are not copied over and over.
    let wanted = map.read_record()?.blocks as usize + keys.len();
    map.grow(u32::try_from(wanted).unwrap_or(u32::MAX))?;
    for some in keys.chunks(AT_A_TIME) {
        let words = &mut words[..some.len() * block_words];
        source.read(some, words)?;
        let blocks = some.iter().zip(words.chunks_exact(block_words));
        let blocks: Vec<_> =
            blocks.map(|(key, words)| HostBlock { key: BlockKey { submap: 0, ..*key }, words }).collect();
        map.insert_blocks(&blocks)?;
    }
    Ok(())
}

/// The submaps that blocks belong to, in their order.
pub(crate) fn submaps(keys: &[BlockKey]) -> Vec<u16> {
    let mut submaps: Vec<u16> = keys.iter().map(|key| key.submap).collect::<HashSet<_>>().into_iter().collect();
    submaps.sort_unstable();
    submaps
}
