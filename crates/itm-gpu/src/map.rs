//! The voxel block map's memory.

use glam::{DVec3, IVec3, UVec3};
use itm_core::voxel::{BLOCK_SIDE, BLOCK_VOXELS, BlockKey, DistanceKind, VoxelKind};
use itm_core::{Intrinsics, Se3};
use itm_shaders::types;

use crate::recorder::Recorder;
use crate::{Device, Error};

/// Bytes of one block in a plane of one word a voxel.
pub(crate) const BLOCK_BYTES: u64 = BLOCK_VOXELS as u64 * 4;
/// Blocks that wait for room; more are dropped, and counted.
pub(crate) const PENDING_CAPACITY: u32 = 1 << 18;
pub(crate) const COUNTERS: u64 = 16;

/// Words of the counters, as `shared/map.wgsl` names them.
pub(crate) mod counter {
    pub(crate) const BLOCKS: u32 = 0;
    pub(crate) const FREE_BLOCKS: u32 = 1;
    pub(crate) const VISIBLE: u32 = 2;
    pub(crate) const REQUESTED: u32 = 3;
    pub(crate) const PENDING: u32 = 5;
    pub(crate) const FRAGMENTS: u32 = 6;
    pub(crate) const TOMBSTONES: u32 = 8;
}

/// Words of the indirect dispatches' buffer.
pub(crate) mod indirect {
    pub(crate) const VISIBLE: u32 = 0;
    pub(crate) const FRAGMENTS: u32 = 4;
    pub(crate) const SCRATCH: u32 = 8;
    pub(crate) const WORDS: u64 = 12;
}

/// What a map is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapLayout {
    /// Edge of a voxel in metres.
    pub voxel_size_m: f32,
    /// Truncation band in metres.
    pub truncation_m: f32,
    /// What a voxel holds.
    pub kind: VoxelKind,
}

/// One part of all voxels, in pages.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    label: &'static str,
    /// Words of a voxel.
    words: usize,
    pub(crate) pages: Vec<wgpu::Buffer>,
}

impl Plane {
    /// Words of a voxel.
    pub(crate) fn words(&self) -> usize {
        self.words
    }

    /// Words of a block.
    pub(crate) fn block_words(&self) -> usize {
        self.words * BLOCK_VOXELS
    }

    fn block_bytes(&self) -> u64 {
        self.block_words() as u64 * 4
    }
}

/// Voxel blocks and what finds them: planes of voxels in pages, a table of keys, a hash of block indices, a grid of block
/// indices around the current view, lists of free, waiting and visible blocks.
#[derive(Clone, Debug)]
pub struct BlockMap {
    device: Device,
    layout: MapLayout,
    capacity: u32,
    hash_slots: u32,
    page_shift: u32,
    submap: u16,
    grid_origin: IVec3,
    grid_size: UVec3,
    pub(crate) counters: wgpu::Buffer,
    pub(crate) indirect: wgpu::Buffer,
    pub(crate) keys: wgpu::Buffer,
    pub(crate) hash: wgpu::Buffer,
    pub(crate) free_blocks: wgpu::Buffer,
    pub(crate) pending: wgpu::Buffer,
    pub(crate) grid: wgpu::Buffer,
    pub(crate) requests: wgpu::Buffer,
    pub(crate) request_counts: wgpu::Buffer,
    pub(crate) visible: wgpu::Buffer,
    pub(crate) visible_bits: wgpu::Buffer,
    pub(crate) visible_counts: wgpu::Buffer,
    pub(crate) boxes: wgpu::Buffer,
    pub(crate) fragment_counts: wgpu::Buffer,
    /// Of each block the last frame whose view reached it; see `swap`.
    pub(crate) last_seen: wgpu::Buffer,
    /// Of each block the last frame that changed it; see `changed`.
    pub(crate) last_changed: wgpu::Buffer,
    /// In the order of [`VoxelKind::block_words`]: distances, then colours and confidences where there are.
    pub(crate) planes: Vec<Plane>,
}

/// A block in the host's memory.
#[derive(Clone, Copy, Debug)]
pub struct HostBlock<'a> {
    /// Where the block lies.
    pub key: BlockKey,
    /// Its voxels, plane by plane (see [`VoxelKind::block_words`]), indexed as [`itm_core::voxel::index_in_block`] says.
    pub words: &'a [u32],
}

/// A frame's record: the map's counters right after it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameRecord {
    /// Blocks in use, and those on the free list.
    pub blocks: u32,
    /// Blocks on the free list.
    pub free_blocks: u32,
    /// Blocks in the view.
    pub visible: u32,
    /// New blocks that the frame asked for.
    pub requested: u32,
    /// New blocks that it got.
    pub allocated: u32,
    /// Requests that wait for room.
    pub pending: u32,
    /// Requests dropped, because even the waiting list was full.
    pub dropped: u32,
    /// Blocks removed since the hash was rebuilt.
    pub tombstones: u32,
}

impl FrameRecord {
    fn new(words: &[u32]) -> Self {
        Self {
            blocks: words[0],
            free_blocks: words[1],
            visible: words[2],
            requested: words[3],
            allocated: words[4],
            pending: words[5],
            dropped: words[7],
            tombstones: words[8],
        }
    }
}

/// A frame's record on its way to the host.
#[derive(Debug)]
pub struct RecordReader {
    staging: wgpu::Buffer,
}

impl RecordReader {
    /// The record; waits for the frame's commands.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<FrameRecord, Error> {
        let words: Vec<u32> = device.read_staging(&self.staging, COUNTERS * 4)?;
        Ok(FrameRecord::new(&words))
    }
}

impl BlockMap {
    /// An empty map with room for `blocks` blocks (as many as the device can hold, if that is less).
    ///
    /// # Errors
    /// Where the device has no room for them.
    pub fn new(device: &Device, layout: MapLayout, blocks: u32) -> Result<Self, Error> {
        let empty = || device.storage("empty", 16);
        let kind = layout.kind;
        let plane = |label, words| Plane { label, words, pages: Vec::new() };
        let mut planes = vec![plane("distances", kind.distance_words())];
        planes.extend(kind.colour.then(|| plane("colours", 1)));
        planes.extend(kind.confidence.then(|| plane("confidences", 1)));
        let mut map = Self {
            device: device.clone(),
            layout,
            capacity: 0,
            hash_slots: 0,
            page_shift: device.capabilities().page_shift(kind),
            submap: 0,
            grid_origin: IVec3::ZERO,
            grid_size: UVec3::ZERO,
            counters: device.storage("counters", COUNTERS * 4),
            indirect: device.storage("indirect", indirect::WORDS * 4),
            keys: empty(),
            hash: empty(),
            free_blocks: empty(),
            pending: device.storage("pending", u64::from(PENDING_CAPACITY) * 8),
            grid: empty(),
            requests: empty(),
            request_counts: empty(),
            visible: empty(),
            visible_bits: empty(),
            visible_counts: empty(),
            boxes: empty(),
            fragment_counts: empty(),
            last_seen: empty(),
            last_changed: empty(),
            planes,
        };
        map.grow(blocks)?;
        Ok(map)
    }

    /// What the map is made of.
    pub fn layout(&self) -> &MapLayout {
        &self.layout
    }

    /// Blocks that the pools can hold.
    pub fn capacity(&self) -> u32 {
        self.capacity
    }

    /// Blocks that the device can hold at most.
    pub fn max_capacity(&self) -> u32 {
        u32::try_from(self.device.capabilities().max_blocks(self.layout.kind)).unwrap_or(u32::MAX).min(1 << 30)
    }

    /// Bytes of device memory that the map takes.
    pub fn device_bytes(&self) -> u64 {
        let pages = self.planes.iter().flat_map(|plane| &plane.pages);
        let rest = [
            &self.counters,
            &self.indirect,
            &self.keys,
            &self.hash,
            &self.free_blocks,
            &self.pending,
            &self.grid,
            &self.requests,
            &self.request_counts,
            &self.visible,
            &self.visible_bits,
            &self.visible_counts,
            &self.boxes,
            &self.fragment_counts,
            &self.last_seen,
            &self.last_changed,
        ];
        pages.chain(rest).map(wgpu::Buffer::size).sum()
    }

    /// Makes room for `blocks` blocks, up to [`BlockMap::max_capacity`]. What the map holds stays; block indices too.
    ///
    /// # Errors
    /// Where the device has no memory left; the map is as it was then, and can be used on.
    pub fn grow(&mut self, blocks: u32) -> Result<(), Error> {
        let blocks = blocks.clamp(1, self.max_capacity());
        if blocks <= self.capacity {
            return Ok(());
        }
        // On a copy (of handles): it takes the map's place only once everything has found memory.
        let mut grown = self.clone();
        let mut recorder = Recorder::new(&self.device);
        let scope = self.device.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        grown.make_larger(&mut recorder, blocks);
        if let Some(error) = pollster::block_on(scope.pop()) {
            return Err(Error::OutOfMemory { reason: error.to_string() });
        }
        let _untimed = recorder.submit();
        *self = grown;
        // So that the copies' sources are freed before anything else is made.
        self.device.wait()
    }

    /// Replaces every buffer whose size follows the capacity, and records the copies.
    fn make_larger(&mut self, recorder: &mut Recorder, blocks: u32) {
        let device = self.device.clone();
        let mut replace = |buffer: &mut wgpu::Buffer, label: &str, bytes: u64, kept: u64| {
            let grown = device.storage(label, bytes);
            if kept > 0 {
                recorder.copy(buffer, &grown, kept);
            }
            *buffer = grown;
        };
        let (new, old) = (u64::from(blocks), u64::from(self.capacity));
        replace(&mut self.keys, "keys", new * 8, old * 8);
        replace(&mut self.free_blocks, "free blocks", new * 4, old * 4);
        replace(&mut self.visible, "visible", new * 4, old * 4);
        replace(&mut self.visible_bits, "visible bits", new.div_ceil(32) * 4, 0);
        replace(&mut self.visible_counts, "visible counts", new.div_ceil(32) * 4, 0);
        replace(&mut self.boxes, "boxes", new * 16, 0);
        replace(&mut self.fragment_counts, "fragment counts", new * 4, 0);
        replace(&mut self.last_seen, "last seen", new * 4, old * 4);
        replace(&mut self.last_changed, "last changed", new * 4, old * 4);

        let page_blocks = 1_u64 << self.page_shift;
        for plane in &mut self.planes {
            let count = new.div_ceil(page_blocks) as usize;
            for page in 0..count {
                let wanted = (new - page as u64 * page_blocks).min(page_blocks) * plane.block_bytes();
                match plane.pages.get_mut(page) {
                    None => plane.pages.push(device.storage(plane.label, wanted)),
                    Some(buffer) if buffer.size() < wanted => {
                        let kept = buffer.size();
                        replace(buffer, plane.label, wanted, kept);
                    }
                    Some(_) => {}
                }
            }
        }
        // At most half full, tombstones aside.
        let slots = (2 * blocks).next_power_of_two();
        if slots > self.hash_slots {
            self.hash = device.storage("hash", u64::from(slots) * 4);
            self.hash_slots = slots;
            self.capacity = blocks;
            crate::hash::Hash::new(&device).rebuild(recorder, self);
        }
        self.capacity = blocks;
    }

    /// Appends blocks with their voxels, growing where needed, and rebuilds the hash: better many blocks at once than
    /// few at a time. No two of them, and none in the map, may have the same key. The grid does not know of them until
    /// `allocate` has filled it anew. Waits.
    ///
    /// # Errors
    /// Where the device cannot hold them, in which case the map stays as it was, or was lost or ran out of memory.
    pub fn insert_blocks(&mut self, blocks: &[HostBlock<'_>]) -> Result<(), Error> {
        let first = self.read_record()?.blocks;
        let wanted = u64::from(first) + blocks.len() as u64;
        let limit = self.max_capacity();
        let count = u32::try_from(wanted).ok().filter(|&count| count <= limit);
        let count = count.ok_or(Error::TooManyBlocks { wanted, limit })?;
        self.grow(count)?;
        let queue = &self.device.queue;
        // Few large writes: each takes a staging buffer of its own. One a megabyte, cut at the pages' borders.
        let upload = (1 << 9).min(1 << self.page_shift);
        let mut index = first;
        let mut rest = blocks;
        while !rest.is_empty() {
            let in_page = index & ((1 << self.page_shift) - 1);
            let room = (upload - in_page % upload) as usize;
            let (now, later) = rest.split_at(room.min(rest.len()));
            self.write_words(index, now);
            let keys: Vec<[u32; 2]> = now.iter().map(|b| b.key.pack()).collect();
            queue.write_buffer(&self.keys, u64::from(index) * 8, bytemuck::cast_slice(&keys));
            // Lets the staging buffers go.
            queue.submit([]);
            index += now.len() as u32;
            rest = later;
        }
        self.finish_insertion(count)
    }

    /// Writes the voxels of blocks whose indices follow one another within a page.
    pub(crate) fn write_words(&self, first: u32, blocks: &[HostBlock<'_>]) {
        let page = (first >> self.page_shift) as usize;
        let in_page = first & ((1 << self.page_shift) - 1);
        let mut first_word = 0;
        for plane in &self.planes {
            let end = first_word + plane.block_words();
            let words: Vec<u32> = blocks.iter().flat_map(|b| &b.words[first_word..end]).copied().collect();
            let at = u64::from(in_page) * plane.block_bytes();
            self.device.queue.write_buffer(&plane.pages[page], at, bytemuck::cast_slice(&words));
            first_word = end;
        }
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Appends blocks of space never seen, as many at once as there are: see [`BlockMap::insert_blocks`].
    ///
    /// # Errors
    /// As [`BlockMap::insert_blocks`].
    pub fn insert_empty(&mut self, keys: &[BlockKey]) -> Result<(), Error> {
        let first = self.read_record()?.blocks;
        let wanted = u64::from(first) + keys.len() as u64;
        let limit = self.max_capacity();
        let count = u32::try_from(wanted).ok().filter(|&count| count <= limit);
        let count = count.ok_or(Error::TooManyBlocks { wanted, limit })?;
        self.grow(count)?;
        let packed: Vec<[u32; 2]> = keys.iter().map(|key| key.pack()).collect();
        self.device.queue.write_buffer(&self.keys, u64::from(first) * 8, bytemuck::cast_slice(&packed));
        self.finish_insertion(count)
    }

    fn finish_insertion(&mut self, count: u32) -> Result<(), Error> {
        let device = self.device.clone();
        device.queue.write_buffer(&self.counters, u64::from(counter::BLOCKS) * 4, bytemuck::bytes_of(&count));
        let mut recorder = Recorder::new(&device);
        crate::hash::Hash::new(&device).rebuild(&mut recorder, self);
        let _untimed = recorder.submit();
        device.wait()
    }

    /// Whose blocks the grid, and every stage that goes by it, is about: one submap at a time, in that submap's frame. The grid
    /// is to be laid anew then.
    pub fn look_at(&mut self, submap: u16) {
        self.submap = submap;
    }

    /// Lays the grid around a view: from now on it covers every block that the camera can see between its nearest and
    /// farthest depth, and `margin_m` around them. The grid is empty until `allocate` has filled it.
    ///
    /// # Errors
    /// Where the view reaches over more blocks than the device can index, or lies further from the origin than blocks can
    /// be numbered.
    pub fn lay_grid(
        &mut self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
        margin_m: f32,
    ) -> Result<(), Error> {
        let around = self.blocks_around(camera, world_from_camera, max_depth_m, margin_m);
        self.lay_grid_over(around, world_from_camera, max_depth_m)
    }

    /// The same for a view of blocks that are all known to lie in a box, from its first to its last block: the grid covers no
    /// more than that, so that a map can be seen from afar.
    ///
    /// # Errors
    /// As [`BlockMap::lay_grid`].
    pub fn lay_grid_within(
        &mut self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
        [first, last]: [IVec3; 2],
    ) -> Result<(), Error> {
        let [lower, upper] = self.blocks_around(camera, world_from_camera, max_depth_m, 0.0);
        // Interpolation reaches into the blocks around.
        let (lower, upper) = (lower.max((first - 1).as_dvec3()), upper.min((last + 1).as_dvec3()));
        // Where nothing of the box is in view, a cell is left.
        let lower = lower.min(last.as_dvec3());
        self.lay_grid_over([lower, upper.max(lower)], world_from_camera, max_depth_m)
    }

    /// The first and the last block that the grid as it lies now covers.
    pub fn grid_box(&self) -> [IVec3; 2] {
        [self.grid_origin, self.grid_origin + self.grid_size.as_ivec3() - 1]
    }

    /// The first and the last block of the box around a view, which may be further away than blocks can be numbered.
    fn blocks_around(
        &self,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
        margin_m: f32,
    ) -> [DVec3; 2] {
        let mut lower = world_from_camera.translation;
        let mut upper = lower;
        for corner in frustum_corners(camera, max_depth_m + margin_m) {
            let corner = world_from_camera.transform_point(corner);
            lower = lower.min(corner);
            upper = upper.max(corner);
        }
        let block = f64::from(self.layout.voxel_size_m) * f64::from(BLOCK_SIDE);
        let margin = DVec3::splat(f64::from(margin_m) + block);
        [((lower - margin) / block).floor(), ((upper + margin) / block).floor()]
    }

    fn lay_grid_over(
        &mut self,
        [first, last]: [DVec3; 2],
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) -> Result<(), Error> {
        let size = last - first + 1.0;
        self.check_cells(size.x * size.y * size.z, max_depth_m)?;
        // A block's position has 16 bits along each axis.
        let reach = f64::from(i16::MAX);
        if !(first.min_element() >= -reach && last.max_element() <= reach) {
            let position = world_from_camera.translation;
            let block = f64::from(self.layout.voxel_size_m) * f64::from(BLOCK_SIDE);
            return Err(Error::OutOfReach {
                position_m: position.to_array(),
                reach_m: reach * block,
                voxel_size_m: self.layout.voxel_size_m,
            });
        }
        let (first, size) = (first.as_ivec3(), size.as_uvec3());
        let cells = u64::from(size.x) * u64::from(size.y) * u64::from(size.z);
        self.grid_origin = first;
        self.grid_size = size;
        let words = cells.div_ceil(32);
        self.device.ensure(&mut self.grid, "grid", cells * 4);
        self.device.ensure(&mut self.requests, "requests", words * 4);
        self.device.ensure(&mut self.request_counts, "request counts", words.div_ceil(32) * 4);
        Ok(())
    }

    /// Whether the grid as it lies now has a cell for a block.
    pub fn grid_covers(&self, key: BlockKey) -> bool {
        let p = key.position - self.grid_origin;
        key.submap == self.submap && p.min_element() >= 0 && p.as_uvec3().cmplt(self.grid_size).all()
    }

    /// Hash slots; at most half of them hold blocks.
    pub fn hash_slots(&self) -> u32 {
        self.hash_slots
    }

    /// Checks that the grid around a camera's view fits the device however the camera turns.
    ///
    /// # Errors
    /// Where it may not.
    pub fn check_view(&self, camera: &Intrinsics, max_depth_m: f32, margin_m: f32) -> Result<(), Error> {
        // No box around the view is wider than its two points that are furthest apart.
        let corners = frustum_corners(camera, max_depth_m + margin_m);
        let ends = corners.iter().chain([&DVec3::ZERO]);
        let widest = ends.flat_map(|a| corners.iter().map(|b| a.distance(*b))).fold(0.0, f64::max);
        let block = f64::from(self.layout.voxel_size_m) * f64::from(BLOCK_SIDE);
        let side = (widest + 2.0 * f64::from(margin_m)) / block + 4.0;
        self.check_cells(side.powi(3), max_depth_m)
    }

    fn check_cells(&self, cells: f64, max_depth_m: f32) -> Result<(), Error> {
        let limit = self.device.capabilities().max_binding_bytes / 4;
        // Also refused: what is not a number.
        if cells <= limit as f64 {
            return Ok(());
        }
        let voxel_size_m = self.layout.voxel_size_m;
        Err(Error::ViewTooLarge { max_depth_m, voxel_size_m, cells: cells as u64, limit })
    }

    /// Cells of the grid as it lies now.
    pub(crate) fn cells(&self) -> u32 {
        self.grid_size.x * self.grid_size.y * self.grid_size.z
    }

    pub(crate) fn page_shift(&self) -> u32 {
        self.page_shift
    }

    /// The map as shaders see it.
    pub(crate) fn params(&self) -> types::Map {
        types::Map {
            grid_origin: self.grid_origin.to_array(),
            hash_mask: self.hash_slots - 1,
            grid_size: self.grid_size.to_array(),
            submap: self.submap.into(),
            voxel_size_m: self.layout.voxel_size_m,
            truncation_m: self.layout.truncation_m,
            page_shift: self.page_shift,
            capacity: self.capacity,
        }
    }

    /// Records a copy of the counters; the result reads them once the recording has been done.
    pub fn record_counters(&self, recorder: &mut Recorder) -> RecordReader {
        let staging = self.device.staging("frame record", COUNTERS * 4);
        recorder.copy(&self.counters, &staging, COUNTERS * 4);
        RecordReader { staging }
    }

    /// Reads the counters; waits for all that was submitted.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_record(&self) -> Result<FrameRecord, Error> {
        Ok(FrameRecord::new(&self.device.read::<u32>(&self.counters, 0, COUNTERS * 4)?))
    }

    /// Reads the keys of all blocks back, by block index; `None` for blocks that are not in use. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_keys(&self) -> Result<Vec<Option<BlockKey>>, Error> {
        let blocks = self.read_record()?.blocks;
        if blocks == 0 {
            return Ok(Vec::new());
        }
        let packed: Vec<[u32; 2]> = self.device.read(&self.keys, 0, u64::from(blocks) * 8)?;
        Ok(packed.into_iter().map(|k| (k != BlockKey::NO_KEY).then(|| BlockKey::unpack(k))).collect())
    }

    /// Reads back how many slots of the hash a look-up of each block in use reads. Waits. For tests.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_probes(&self) -> Result<Vec<u32>, Error> {
        let slots: Vec<u32> = self.device.read(&self.hash, 0, u64::from(self.hash_slots) * 4)?;
        let mask = self.hash_slots - 1;
        let probes = |(key, index): (BlockKey, u32)| {
            let first = crate::reference::hash::hash_of(key) & mask;
            let found = (0..=mask).find(|i| slots[((first + i) & mask) as usize] == index + 1);
            found.map_or(u32::MAX, |i| i + 1)
        };
        let keys = self.read_keys()?.into_iter().zip(0..);
        Ok(keys.filter_map(|(key, index)| Some(probes((key?, index)))).collect())
    }

    /// Reads one block's voxels back, plane by plane (see [`VoxelKind::block_words`]). Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_block(&self, block: u32) -> Result<Vec<u32>, Error> {
        let in_page = u64::from(block & ((1 << self.page_shift) - 1));
        let mut words = Vec::with_capacity(self.layout.kind.block_words());
        for plane in &self.planes {
            let page = &plane.pages[(block >> self.page_shift) as usize];
            words.extend(self.device.read::<u32>(page, in_page * plane.block_bytes(), plane.block_bytes())?);
        }
        Ok(words)
    }

    /// The distances' pages.
    pub(crate) fn distances(&self) -> &[wgpu::Buffer] {
        &self.planes[0].pages
    }

    /// The colours' pages; none where the map has no colour.
    pub(crate) fn colours(&self) -> &[wgpu::Buffer] {
        if self.layout.kind.colour { &self.planes[1].pages } else { &[] }
    }

    /// The confidences' pages; none where the map has no confidence.
    pub(crate) fn confidences(&self) -> &[wgpu::Buffer] {
        match self.planes.last() {
            Some(plane) if self.layout.kind.confidence => &plane.pages,
            _ => &[],
        }
    }

    /// The shader features that the distances' kind asks for.
    pub(crate) fn distance_features(&self) -> &'static [&'static str] {
        distance_features(self.layout.kind)
    }
}

/// The shader features that a kind of distance asks for.
pub(crate) fn distance_features(kind: VoxelKind) -> &'static [&'static str] {
    match kind.distance {
        DistanceKind::I16 => &[],
        DistanceKind::F32 => &["f32"],
    }
}

/// What the image's four corners see at a depth (camera frame, metres).
fn frustum_corners(camera: &Intrinsics, depth_m: f32) -> [DVec3; 4] {
    let (w, h) = (f64::from(camera.width) - 0.5, f64::from(camera.height) - 0.5);
    [(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)].map(|(x, y)| camera.unproject(glam::DVec2::new(x, y), depth_m.into()))
}

/// A camera as shaders see it.
pub(crate) fn camera_params(camera: &Intrinsics, depth_range_m: [f32; 2]) -> types::Camera {
    types::Camera {
        focal: [camera.fx as f32, camera.fy as f32],
        centre: [camera.cx as f32, camera.cy as f32],
        size: [camera.width, camera.height],
        depth_range: depth_range_m,
    }
}
