//! The host's store of blocks that were swapped out of the device.
//!
//! Blocks lie in memory up to a budget, and beyond it in a file: those that were put longest ago go there first. Which
//! ones depends on the calls alone, so that a run repeats.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use itm_core::voxel::BlockKey;

use crate::Error;

/// Where a store keeps what finds no room in memory. The file comes to be when the first block goes there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoreFile {
    /// A file without a name, in this folder or the system's own for temporary files. It is gone with the store, however
    /// the program ends.
    Temporary(Option<PathBuf>),
    /// A file of this name, which stays. One that is there is overwritten. It holds the words of blocks in this machine's
    /// byte order, but not which block is where: it is of use to this store only.
    Kept(PathBuf),
}

impl StoreFile {
    /// Whether the file can be made, where its place was chosen: better known before there is something to lose. A kept file is
    /// made by it. The system's own folder is taken as it is.
    ///
    /// # Errors
    /// Where it cannot, with the place and the reason.
    pub fn check(&self) -> Result<(), Error> {
        match self {
            Self::Temporary(Some(path)) | Self::Kept(path) => match open(self) {
                Ok(_closed_at_once) => Ok(()),
                Err(reason) => Err(Error::io("create a file of blocks at", path, reason)),
            },
            Self::Temporary(None) => Ok(()),
        }
    }
}

/// Whether a block found room where it should.
#[must_use = "a store that cannot write its file goes on beyond its memory budget"]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placed {
    /// The memory budget is kept.
    WithinBudget,
    /// The file could not be written, so more lies in memory than the budget allows; nothing is lost.
    /// [`BlockStore::trouble`] says why. Each further [`BlockStore::put`] tries the file again.
    BeyondBudget,
}

/// Swapped-out blocks by their keys, each a fixed number of words.
///
/// The index comes on top of the memory budget: about 60 bytes a block in memory and 40 a block in the file, where a
/// block itself has 2 KiB and more.
///
/// ```
/// use glam::IVec3;
/// use itm_core::voxel::{BlockKey, VoxelKind};
/// use itm_io::block_store::{BlockStore, Placed, StoreFile};
///
/// let words = VoxelKind::default().block_words();
/// let mut store = BlockStore::new(words, 64 << 20, StoreFile::Temporary(None));
/// let key = BlockKey { submap: 0, position: IVec3::new(1, -2, 3) };
/// if store.put(key, &vec![7; words]) == Placed::BeyondBudget {
///     println!("{}", store.trouble().expect("there is a reason"));
/// }
/// let mut block = vec![0; words];
/// assert!(store.take(key, &mut block)? && block[0] == 7);
/// assert!(store.is_empty());
/// # Ok::<(), itm_io::Error>(())
/// ```
#[derive(Debug)]
pub struct BlockStore {
    index: BTreeMap<[u32; 2], Place>,
    /// Keys of the blocks in memory, by when they were put.
    ages: BTreeMap<u64, [u32; 2]>,
    puts: u64,
    memory: Arena,
    budget_blocks: usize,
    file: SlotFile,
    trouble: Option<Error>,
}

#[derive(Clone, Copy, Debug)]
enum Place {
    Memory { slot: u32, put: u64 },
    File { slot: u32 },
}

impl BlockStore {
    /// An empty store of blocks of so many words, which keeps to so many bytes of memory and has so much more room as the
    /// file's disk.
    ///
    /// # Panics
    /// Where blocks have no words.
    pub fn new(block_words: usize, memory_budget_bytes: u64, file: StoreFile) -> Self {
        assert!(block_words > 0, "blocks have words");
        let budget_blocks = usize::try_from(memory_budget_bytes / (block_words as u64 * 4)).unwrap_or(usize::MAX);
        let memory = Arena::new(block_words, budget_blocks);
        // What memory is taken in has to fit as a whole.
        let budget_blocks = budget_blocks - budget_blocks % memory.chunk_slots;
        let file = SlotFile { place: file, open: None, slots: Slots::default(), block_bytes: block_words as u64 * 4 };
        Self { index: BTreeMap::new(), ages: BTreeMap::new(), puts: 0, memory, budget_blocks, file, trouble: None }
    }

    /// Puts a block, in place of one of the same key.
    ///
    /// # Panics
    /// Where the block does not have the store's number of words.
    pub fn put(&mut self, key: BlockKey, block: &[u32]) -> Placed {
        self.check_length(block);
        let key = key.pack();
        self.puts += 1;
        let put = self.puts;
        if let Some(Place::Memory { slot, put: before }) = self.index.get_mut(&key) {
            self.memory.block_mut(*slot).copy_from_slice(block);
            self.ages.remove(before);
            self.ages.insert(put, key);
            *before = put;
            return self.make_room(self.budget_blocks);
        }
        // Whether that succeeded shows in how many there are in the end.
        let _ = self.make_room(self.budget_blocks.saturating_sub(1));
        let place = match self.write_directly(block) {
            Some(slot) => Place::File { slot },
            None => {
                let slot = self.memory.slots.take();
                self.memory.block_mut(slot).copy_from_slice(block);
                self.ages.insert(put, key);
                Place::Memory { slot, put }
            }
        };
        // The old one goes last, so that there is no moment without either.
        if let Some(Place::File { slot }) = self.index.insert(key, place) {
            self.file.give(slot);
        }
        if self.ages.len() > self.budget_blocks { Placed::BeyondBudget } else { Placed::WithinBudget }
    }

    /// Copies a block out and removes it. Whether there was one; `block` is left alone where there was none.
    ///
    /// # Errors
    /// Where the file cannot be read. The block stays in the store then; what `block` holds is not said.
    ///
    /// # Panics
    /// Where `block` does not have the store's number of words.
    pub fn take(&mut self, key: BlockKey, block: &mut [u32]) -> Result<bool, Error> {
        let found = self.get(key, block)?;
        match self.index.remove(&key.pack()) {
            Some(Place::Memory { slot, put }) => {
                self.ages.remove(&put);
                self.memory.give(slot, self.budget_blocks);
            }
            Some(Place::File { slot }) => self.file.give(slot),
            None => {}
        }
        Ok(found)
    }

    /// Copies a block out and leaves it where it is. Whether there was one.
    ///
    /// # Errors
    /// Where the file cannot be read.
    ///
    /// # Panics
    /// Where `block` does not have the store's number of words.
    pub fn get(&self, key: BlockKey, block: &mut [u32]) -> Result<bool, Error> {
        self.check_length(block);
        match self.index.get(&key.pack()) {
            Some(Place::Memory { slot, .. }) => block.copy_from_slice(self.memory.block(*slot)),
            Some(Place::File { slot }) => self.file.read(*slot, block)?,
            None => return Ok(false),
        }
        Ok(true)
    }

    /// Whether there is a block of this key.
    pub fn contains(&self, key: BlockKey) -> bool {
        self.index.contains_key(&key.pack())
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there is no block.
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// All keys, sorted by their packed words, the first one first.
    pub fn keys(&self) -> impl ExactSizeIterator<Item = BlockKey> + '_ {
        self.index.keys().map(|&key| BlockKey::unpack(key))
    }

    /// Bytes of memory that blocks have been given, in use or free; the index is not counted. Never more than the budget
    /// where the file could always be written. What was taken beyond it goes back chunk by chunk (1 MiB) as those empty.
    pub fn memory_bytes(&self) -> u64 {
        self.memory.bytes()
    }

    /// Bytes of the file, in use or free.
    pub fn file_bytes(&self) -> u64 {
        u64::from(self.file.slots.count) * self.file.block_bytes
    }

    /// Number of blocks that lie in the file.
    pub fn blocks_in_file(&self) -> usize {
        self.index.len() - self.ages.len()
    }

    /// Why the file could not be written the last time, which path and what the system said; `None` once it can be written
    /// again, or where it was never tried.
    pub fn trouble(&self) -> Option<&Error> {
        self.trouble.as_ref()
    }

    fn check_length(&self, block: &[u32]) {
        assert_eq!(block.len(), self.memory.block_words, "words of a block");
    }

    /// Moves the blocks put longest ago to the file until so many are left in memory, or until it cannot be written.
    fn make_room(&mut self, blocks: usize) -> Placed {
        while self.ages.len() > blocks {
            let (&put, &key) = self.ages.first_key_value().expect("there are more than `blocks`");
            let Some(Place::Memory { slot, .. }) = self.index.get(&key).copied() else {
                unreachable!("what has an age is in memory");
            };
            match self.file.write(self.memory.block(slot)) {
                Ok(in_file) => {
                    self.trouble = None;
                    self.index.insert(key, Place::File { slot: in_file });
                    self.ages.remove(&put);
                    self.memory.give(slot, self.budget_blocks);
                }
                Err(error) => {
                    self.trouble = Some(error);
                    return Placed::BeyondBudget;
                }
            }
        }
        Placed::WithinBudget
    }

    /// The slot in the file of a block for which memory never has room; `None` where it has, or where the file cannot be
    /// written.
    fn write_directly(&mut self, block: &[u32]) -> Option<u32> {
        if self.budget_blocks > 0 {
            return None;
        }
        let written = self.file.write(block);
        written.map_err(|error| self.trouble = Some(error)).inspect(|_| self.trouble = None).ok()
    }
}

/// Numbers from 0 up, of which the lowest free one is always next.
#[derive(Debug, Default)]
struct Slots {
    /// Free ones below `count`.
    free: BTreeSet<u32>,
    count: u32,
}

impl Slots {
    fn take(&mut self) -> u32 {
        self.free.pop_first().unwrap_or_else(|| {
            let slot = self.count;
            self.count = slot.checked_add(1).expect("2^32 blocks are 8 TiB");
            slot
        })
    }

    fn give(&mut self, slot: u32) {
        self.free.insert(slot);
        while self.count > 0 && self.free.remove(&(self.count - 1)) {
            self.count -= 1;
        }
    }
}

/// Memory in chunks, so that growth copies nothing.
#[derive(Debug)]
struct Arena {
    slots: Slots,
    chunks: Vec<Box<[u32]>>,
    chunk_slots: usize,
    block_words: usize,
}

impl Arena {
    /// Chunks are of 1 MiB, or the sixteenth part of a small budget.
    fn new(block_words: usize, budget_blocks: usize) -> Self {
        const CHUNK_BYTES: usize = 1 << 20;
        let chunk_slots = (CHUNK_BYTES / (block_words * 4)).min(budget_blocks / 16).max(1);
        Self { slots: Slots::default(), chunks: Vec::new(), chunk_slots, block_words }
    }

    fn bytes(&self) -> u64 {
        (self.chunks.len() * self.chunk_slots * self.block_words * 4) as u64
    }

    fn block(&self, slot: u32) -> &[u32] {
        let (chunk, at) = (slot as usize / self.chunk_slots, slot as usize % self.chunk_slots);
        &self.chunks[chunk][at * self.block_words..][..self.block_words]
    }

    /// Takes a further chunk where the slot is in none yet.
    fn block_mut(&mut self, slot: u32) -> &mut [u32] {
        let (chunk, at) = (slot as usize / self.chunk_slots, slot as usize % self.chunk_slots);
        while self.chunks.len() <= chunk {
            self.chunks.push(vec![0; self.chunk_slots * self.block_words].into());
        }
        &mut self.chunks[chunk][at * self.block_words..][..self.block_words]
    }

    /// Frees a slot. Chunks beyond the budget go back to the system as soon as nothing is in them; others stay for what
    /// comes.
    fn give(&mut self, slot: u32, budget_blocks: usize) {
        self.slots.give(slot);
        let used = (self.slots.count as usize).div_ceil(self.chunk_slots);
        self.chunks.truncate(used.max(budget_blocks / self.chunk_slots));
    }
}

/// A file of blocks, one after the other.
#[derive(Debug)]
struct SlotFile {
    place: StoreFile,
    /// There from the first block on.
    open: Option<File>,
    slots: Slots,
    block_bytes: u64,
}

impl SlotFile {
    /// What errors name.
    fn path(&self) -> PathBuf {
        match &self.place {
            StoreFile::Temporary(Some(path)) | StoreFile::Kept(path) => path.clone(),
            StoreFile::Temporary(None) => std::env::temp_dir(),
        }
    }

    fn write(&mut self, block: &[u32]) -> Result<u32, Error> {
        if self.open.is_none() {
            let file = open(&self.place).map_err(|e| Error::io("create a file of blocks at", &self.path(), e))?;
            self.open = Some(file);
        }
        let slot = self.slots.take();
        let written = self.at(slot).and_then(|mut file| file.write_all(bytemuck::cast_slice(block)));
        if let Err(reason) = written {
            // Whatever part of it was written is in nobody's slot.
            self.slots.give(slot);
            return Err(Error::io("write blocks to", &self.path(), reason));
        }
        Ok(slot)
    }

    fn read(&self, slot: u32, block: &mut [u32]) -> Result<(), Error> {
        let read = self.at(slot).and_then(|mut file| file.read_exact(bytemuck::cast_slice_mut(block)));
        read.map_err(|e| Error::io("read blocks from", &self.path(), e))
    }

    fn at(&self, slot: u32) -> io::Result<&File> {
        let mut file = self.open.as_ref().expect("slots are given out once it is open");
        file.seek(SeekFrom::Start(u64::from(slot) * self.block_bytes))?;
        Ok(file)
    }

    fn give(&mut self, slot: u32) {
        self.slots.give(slot);
        if self.slots.count == 0
            && let Some(file) = &self.open
        {
            // Only to give the disk's room back; it is reused where this fails.
            let _ = file.set_len(0);
        }
    }
}

fn open(place: &StoreFile) -> io::Result<File> {
    match place {
        StoreFile::Temporary(None) => tempfile::tempfile(),
        StoreFile::Temporary(Some(folder)) => tempfile::tempfile_in(folder),
        StoreFile::Kept(path) => open_kept(path),
    }
}

fn open_kept(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create(true).truncate(true).open(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::IVec3;
    use proptest::prelude::*;
    use std::collections::HashMap;

    const WORDS: usize = 4;

    fn key(number: i32) -> BlockKey {
        BlockKey { submap: number.rem_euclid(3) as u16, position: IVec3::new(number, -number, 1) }
    }

    fn read(store: &BlockStore, number: i32) -> Option<u32> {
        let mut block = [0; WORDS];
        let found = store.get(key(number), &mut block).unwrap();
        assert!(block.iter().all(|w| *w == block[0]));
        found.then_some(block[0])
    }

    proptest! {
        #[test]
        fn it_is_a_map_whatever_lies_where(
            calls in prop::collection::vec((0..20i32, any::<bool>(), any::<u32>()), 1..200),
            budget in 0..40u64,
            kept: bool,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let file =
                if kept { StoreFile::Kept(folder.path().join("blocks")) } else { StoreFile::Temporary(Some(folder.path().into())) };
            let budget_bytes = budget * WORDS as u64 * 4;
            let mut store = BlockStore::new(WORDS, budget_bytes, file);
            let mut model = HashMap::new();
            for (number, put, value) in calls {
                if put {
                    prop_assert_eq!(store.put(key(number), &[value; WORDS]), Placed::WithinBudget);
                    model.insert(number, value);
                } else {
                    let mut block = [0; WORDS];
                    let taken = store.take(key(number), &mut block).unwrap().then_some(block);
                    prop_assert_eq!(taken, model.remove(&number).map(|v| [v; WORDS]));
                }
                prop_assert_eq!(store.len(), model.len());
                prop_assert!(store.memory_bytes() <= budget_bytes);
                // Slots are used again: there are never more than there were blocks at once.
                prop_assert!(store.file_bytes() <= 21 * WORDS as u64 * 4);
            }
            for number in 0..20 {
                prop_assert_eq!(read(&store, number), model.get(&number).copied());
                prop_assert_eq!(store.contains(key(number)), model.contains_key(&number));
            }
            let keys: Vec<_> = store.keys().map(BlockKey::pack).collect();
            prop_assert!(keys.is_sorted() && keys.len() == model.len());
            prop_assert!(store.trouble().is_none());
        }
    }

    #[test]
    fn blocks_put_longest_ago_go_to_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("blocks");
        let mut store = BlockStore::new(WORDS, 3 * WORDS as u64 * 4, StoreFile::Kept(path.clone()));
        let mut put = |number: i32| assert_eq!(store.put(key(number), &[number as u32; WORDS]), Placed::WithinBudget);
        (0..3).for_each(&mut put);
        assert!(!path.exists(), "there is room in memory");
        // Put again, 0 is the youngest: 1 and 2 go first.
        [0, 3, 4].into_iter().for_each(&mut put);
        let file: Vec<u8> = [1u32, 2].into_iter().flat_map(|v| [v; WORDS]).flat_map(u32::to_ne_bytes).collect();
        assert_eq!(std::fs::read(&path).unwrap(), file);
        assert_eq!((store.len(), store.blocks_in_file(), store.file_bytes()), (5, 2, 32));
        drop(store);
        assert!(path.exists(), "kept");
    }

    #[test]
    fn an_unwritable_place_loses_nothing_and_is_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let later = folder.path().join("later");
        for file in [StoreFile::Kept(later.join("blocks")), StoreFile::Temporary(Some(later.clone()))] {
            for budget_blocks in [0, 2] {
                let mut store = BlockStore::new(WORDS, budget_blocks * 16, file.clone());
                for number in 0..5 {
                    let placed = store.put(key(number), &[number as u32; WORDS]);
                    assert_eq!(placed == Placed::WithinBudget, (number as u64) < budget_blocks);
                }
                let trouble = store.trouble().unwrap().to_string();
                assert!(trouble.starts_with("cannot create") && trouble.contains("later"), "{trouble}");
                assert_eq!((store.len(), store.blocks_in_file(), store.memory_bytes()), (5, 0, 80));
                assert!((0..5).all(|number| read(&store, number) == Some(number as u32)));

                std::fs::create_dir(&later).unwrap();
                assert_eq!(store.put(key(5), &[5; WORDS]), Placed::WithinBudget);
                assert!(store.trouble().is_none());
                assert_eq!(store.blocks_in_file() as u64, 6 - budget_blocks);
                assert!((0..6).all(|number| read(&store, number) == Some(number as u32)));
                drop(store);
                std::fs::remove_dir_all(&later).unwrap();
            }
        }
    }

    #[test]
    fn a_block_that_cannot_be_read_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("blocks");
        let mut store = BlockStore::new(WORDS, 0, StoreFile::Kept(path.clone()));
        assert_eq!(store.put(key(0), &[7; WORDS]), Placed::WithinBudget);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, "short").unwrap();
        let error = store.take(key(0), &mut [0; WORDS]).unwrap_err().to_string();
        assert!(error.contains("cannot read blocks from") && error.contains("blocks"), "{error}");
        std::fs::write(&path, whole).unwrap();
        assert_eq!(read(&store, 0), Some(7));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_loses_nothing() {
        let mut store = BlockStore::new(WORDS, 16, StoreFile::Kept("/dev/full".into()));
        assert_eq!(store.put(key(0), &[0; WORDS]), Placed::WithinBudget);
        assert_eq!(store.put(key(1), &[1; WORDS]), Placed::BeyondBudget);
        let trouble = store.trouble().unwrap();
        assert!(trouble.to_string().contains("cannot write blocks to '/dev/full'"), "{trouble}");
        assert!(matches!(trouble, Error::Io { reason, .. } if reason.kind() == io::ErrorKind::StorageFull));
        // Replacing within too much is too much still; once blocks are taken it is not.
        assert_eq!(store.put(key(1), &[2; WORDS]), Placed::BeyondBudget);
        assert!(store.take(key(0), &mut [9; WORDS]).unwrap());
        assert_eq!(store.put(key(1), &[3; WORDS]), Placed::WithinBudget);
        assert_eq!((read(&store, 0), read(&store, 1), store.file_bytes()), (None, Some(3), 0));
    }
}
