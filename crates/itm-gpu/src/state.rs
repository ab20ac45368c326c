//! What lies on the device as plain numbers, so that a session can be saved and go on as if it had never stopped.

use itm_core::voxel::BlockKey;

use crate::hash::Hash;
use crate::map::{COUNTERS, counter};
use crate::photometric::PointList;
use crate::{BlockMap, Device, Error, FrameRecord, HostBlock, MapLayout, RaycastImage, Recorder};

/// All of a block map but its voxels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapState {
    /// Blocks that the pools can hold.
    pub capacity: u32,
    /// The device's counters.
    pub counters: Vec<u32>,
    /// Key of each block index that was ever used, packed; [`BlockKey::NO_KEY`] for those that are free.
    pub keys: Vec<[u32; 2]>,
    /// Free block indices, the next one to be taken last.
    pub free_blocks: Vec<u32>,
    /// Keys of blocks that wait for room, packed.
    pub pending: Vec<[u32; 2]>,
    /// Of each block index the last view that reached it; see [`crate::swap`].
    pub last_seen: Vec<u32>,
    /// Of each block index the last frame that changed it; see [`crate::changed`].
    pub last_changed: Vec<u32>,
}

impl FrameRecord {
    /// As numbers.
    pub fn to_words(&self) -> [u32; 8] {
        let Self { blocks, free_blocks, visible, requested, allocated, pending, dropped, tombstones } = *self;
        [blocks, free_blocks, visible, requested, allocated, pending, dropped, tombstones]
    }

    /// The inverse of [`FrameRecord::to_words`].
    pub fn from_words(words: [u32; 8]) -> Self {
        let [blocks, free_blocks, visible, requested, allocated, pending, dropped, tombstones] = words;
        Self { blocks, free_blocks, visible, requested, allocated, pending, dropped, tombstones }
    }
}

/// Blocks that are copied to the host, or to the device, at a time.
const BLOCKS_AT_ONCE: u32 = 4096;

impl BlockMap {
    /// Reads all but the voxels back. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_state(&self) -> Result<MapState, Error> {
        let counters: Vec<u32> = self.device().read(&self.counters, 0, COUNTERS * 4)?;
        let record = self.read_record()?;
        Ok(MapState {
            capacity: self.capacity(),
            keys: self.read_some(&self.keys, record.blocks)?,
            free_blocks: self.read_some(&self.free_blocks, record.free_blocks)?,
            pending: self.read_some(&self.pending, record.pending)?,
            last_seen: self.read_some(&self.last_seen, record.blocks)?,
            last_changed: self.read_some(&self.last_changed, record.blocks)?,
            counters,
        })
    }

    fn read_some<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, count: u32) -> Result<Vec<T>, Error> {
        match count {
            0 => Ok(Vec::new()),
            count => self.device().read(buffer, 0, u64::from(count) * size_of::<T>() as u64),
        }
    }

    /// Reads all blocks back, in the order of their indices, and hands each on with its key; `None`, and no words, for an
    /// index that is not in use. Some thousand blocks lie in the host's memory at a time. Waits.
    ///
    /// # Errors
    /// Where the device was lost, and what `each` returns.
    pub fn read_blocks<E: From<Error>>(
        &self,
        mut each: impl FnMut(Option<BlockKey>, &[u32]) -> Result<(), E>,
    ) -> Result<(), E> {
        let keys = self.read_keys()?;
        let page_blocks = 1_u32 << self.page_shift();
        let count = keys.len() as u32;
        let mut first = 0;
        while first < count {
            let in_page = first & (page_blocks - 1);
            let some = BLOCKS_AT_ONCE.min(count - first).min(page_blocks - in_page);
            let mut planes = Vec::new();
            for plane in &self.planes {
                let block_words = plane.block_words();
                let bytes = block_words as u64 * 4;
                let page = &plane.pages[(first / page_blocks) as usize];
                let words = self.device().read::<u32>(page, u64::from(in_page) * bytes, u64::from(some) * bytes)?;
                planes.push((block_words, words));
            }
            let mut block = Vec::with_capacity(self.layout().kind.block_words());
            for i in 0..some as usize {
                let key = keys[first as usize + i];
                block.clear();
                if key.is_some() {
                    for (length, words) in &planes {
                        block.extend_from_slice(&words[i * length..(i + 1) * length]);
                    }
                }
                each(key, &block)?;
            }
            first += some;
        }
        Ok(())
    }

    /// A map as it was read back. Its blocks' voxels are empty until [`BlockMap::write_blocks`] brings them.
    ///
    /// # Errors
    /// Where the device has no room, and where the numbers do not fit together.
    pub fn from_state(device: &Device, layout: MapLayout, state: &MapState) -> Result<Self, Error> {
        let map = Self::new(device, layout, state.capacity)?;
        let blocks = state.keys.len();
        let counted = |slot: u32| state.counters.get(slot as usize).map(|count| *count as usize);
        let fits = state.counters.len() as u64 == COUNTERS
            && map.capacity() == state.capacity
            && blocks <= state.capacity as usize
            && state.last_seen.len() == blocks
            && state.last_changed.len() == blocks
            && state.free_blocks.iter().all(|block| (*block as usize) < blocks)
            && counted(counter::BLOCKS) == Some(blocks)
            && counted(counter::FREE_BLOCKS) == Some(state.free_blocks.len())
            && counted(counter::PENDING) == Some(state.pending.len())
            && state.pending.len() <= crate::map::PENDING_CAPACITY as usize;
        if !fits {
            return Err(Error::State { what: "block map" });
        }
        let queue = &device.queue;
        queue.write_buffer(&map.keys, 0, bytemuck::cast_slice(&state.keys));
        queue.write_buffer(&map.free_blocks, 0, bytemuck::cast_slice(&state.free_blocks));
        queue.write_buffer(&map.pending, 0, bytemuck::cast_slice(&state.pending));
        queue.write_buffer(&map.last_seen, 0, bytemuck::cast_slice(&state.last_seen));
        queue.write_buffer(&map.last_changed, 0, bytemuck::cast_slice(&state.last_changed));
        queue.write_buffer(&map.counters, 0, bytemuck::cast_slice(&state.counters));
        let mut recorder = Recorder::new(device);
        Hash::new(device).rebuild(&mut recorder, &map);
        let _untimed = recorder.submit();
        // Rebuilding has reset the number of tombstones.
        queue.write_buffer(&map.counters, 0, bytemuck::cast_slice(&state.counters));
        queue.submit([]);
        device.wait()?;
        Ok(map)
    }

    /// Writes the voxels of the blocks with the indices from `first` on; nothing for those without words. At most some
    /// thousand at a time should be given.
    ///
    /// # Panics
    /// Where the map has no such blocks.
    pub fn write_blocks(&self, first: u32, blocks: &[HostBlock<'_>]) {
        let page_blocks = 1_u32 << self.page_shift();
        let mut index = first;
        for run in blocks.chunk_by(|a, b| a.words.is_empty() == b.words.is_empty()) {
            let mut rest = run;
            while !rest.is_empty() {
                let in_page = index & (page_blocks - 1);
                let (now, later) = rest.split_at(rest.len().min((page_blocks - in_page) as usize));
                if !now[0].words.is_empty() {
                    self.write_words(index, now);
                }
                index += now.len() as u32;
                rest = later;
            }
        }
        // Lets the staging buffers go.
        self.device().queue.submit([]);
    }
}

impl RaycastImage {
    /// Reads points and normals back as bytes. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_bytes(&self, device: &Device) -> Result<Vec<u8>, Error> {
        let bytes = self.camera().pixels() as u64 * 16;
        let points: Vec<u8> = device.read(&self.points, 0, bytes)?;
        let normals: Vec<u8> = device.read(&self.normals, 0, bytes)?;
        Ok([points, normals].concat())
    }

    /// Takes over what [`RaycastImage::read_bytes`] gave for an image of the same size.
    ///
    /// # Errors
    /// Where it has another length.
    pub fn write_bytes(&self, device: &Device, bytes: &[u8]) -> Result<(), Error> {
        let half = self.camera().pixels() * 16;
        if bytes.len() != 2 * half {
            return Err(Error::State { what: "model" });
        }
        device.queue.write_buffer(&self.points, 0, &bytes[..half]);
        device.queue.write_buffer(&self.normals, 0, &bytes[half..]);
        Ok(())
    }
}

impl PointList {
    /// Reads all levels back as bytes. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_bytes(&self, device: &Device) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        for buffer in self.buffers() {
            bytes.extend(device.read::<u8>(buffer, 0, buffer.size())?);
        }
        Ok(bytes)
    }

    /// Takes over what [`PointList::read_bytes`] gave for lists of the same sizes.
    ///
    /// # Errors
    /// Where it has another length.
    pub fn write_bytes(&self, device: &Device, bytes: &[u8]) -> Result<(), Error> {
        let length: u64 = self.buffers().map(wgpu::Buffer::size).sum();
        if bytes.len() as u64 != length {
            return Err(Error::State { what: "list of coloured points" });
        }
        let mut rest = bytes;
        for buffer in self.buffers() {
            let (now, later) = rest.split_at(buffer.size() as usize);
            device.queue.write_buffer(buffer, 0, now);
            rest = later;
        }
        Ok(())
    }
}
