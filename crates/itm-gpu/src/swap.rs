//! Stage `swap`: blocks leave the device for the host, and come back (the report, section on swapping).
//!
//! Each frame notes which blocks its view reaches, and sorts the others by how long ago one last did. Those that are to
//! leave are gathered into a transfer buffer of a fixed size and taken out of the hash; those that come back are requests
//! like those of the frame's depth, and are fused with what was integrated at their places meanwhile. When, which and how
//! many is itm-slam's to say.

use std::sync::OnceLock;

use itm_core::voxel::{BlockKey, DistanceKind};
use itm_core::{Intrinsics, Se3};
use itm_shaders::swap;

use crate::hash::Hash;
use crate::recorder::{Groups, Pipeline};
use crate::scan::{Scan, Total};
use crate::visible::frustum;
use crate::{BlockMap, Device, Error, HostBlock, Recorder};

/// Bins that ages are counted in.
pub const AGE_BINS: usize = 64;

/// The smallest age in frames that falls into a bin; bins widen with the age, four to each power of two. The first bin stays
/// empty.
pub fn age_of_bin(bin: usize) -> u32 {
    match bin {
        0..4 => bin as u32,
        _ => (4 + bin as u32 % 4) << (bin / 4 - 1),
    }
}

/// Workgroups that gather blocks, one block at a time each: a list is rarely as long as it may be.
const GATHERED_AT_ONCE: u64 = 256;

/// The stage's pipelines.
#[derive(Debug)]
pub struct Swap {
    device: Device,
    age: Pipeline,
    select: Pipeline,
    scan: Scan,
    list: Pipeline,
    gather: Gather,
    /// By kind of distance.
    empty: [OnceLock<Pipeline>; 2],
    count: Pipeline,
    place: Pipeline,
    /// Colours, confidences, distances of 16 bits and in single precision.
    merge: [OnceLock<Pipeline>; 4],
    hash: Hash,
    ages: wgpu::Buffer,
    /// Where a scan's total becomes an indirect dispatch that nobody makes.
    unused_dispatch: wgpu::Buffer,
}

/// Fixed buffers between host and device, which bound what is transferred in a frame. Clones are handles of the same.
#[derive(Clone, Debug)]
pub struct Transfer {
    room: u32,
    listed: wgpu::Buffer,
    keys: wgpu::Buffer,
    count: wgpu::Buffer,
    words: wgpu::Buffer,
    changed: wgpu::Buffer,
}

impl Transfer {
    /// Buffers for so many blocks of a map, or as many as the device can bind.
    pub fn new(device: &Device, map: &BlockMap, room: u32) -> Self {
        let block_bytes = map.layout().kind.block_bytes();
        let most = device.capabilities().max_binding_bytes / block_bytes;
        let room = room.clamp(1, u32::try_from(most).unwrap_or(u32::MAX));
        Self {
            room,
            listed: device.storage("transferred blocks", u64::from(room) * 4),
            keys: device.storage("transferred keys", u64::from(room) * 8),
            count: device.storage("transferred count", 16),
            words: device.storage("transferred voxels", u64::from(room) * block_bytes),
            changed: device.storage("transferred changes", u64::from(room) * 4),
        }
    }

    /// Blocks that it holds.
    pub fn room(&self) -> u32 {
        self.room
    }
}

/// Blocks on their way to the device.
#[derive(Clone, Debug)]
pub struct Arrivals {
    transfer: Transfer,
    count: u32,
}

impl Arrivals {
    /// Where each block lies once it was merged: its index plus one, or zero where it found no room.
    pub(crate) fn places(&self) -> &wgpu::Buffer {
        &self.transfer.listed
    }

    /// Of each block the last frame that changed it, where someone keeps that.
    pub(crate) fn changed(&self) -> &wgpu::Buffer {
        &self.transfer.changed
    }

    pub(crate) fn keys(&self) -> &wgpu::Buffer {
        &self.transfer.keys
    }

    pub(crate) fn count(&self) -> u32 {
        self.count
    }
}

/// The ages of a frame on their way to the host.
#[derive(Debug)]
pub struct AgesReader {
    staging: wgpu::Buffer,
}

impl AgesReader {
    /// How many blocks that the frame's view did not reach are of each age, in bins; see [`age_of_bin`]. Waits for the frame.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<Vec<u32>, Error> {
        device.read_staging(&self.staging, AGE_BINS as u64 * 4)
    }
}

/// Blocks on their way to the host.
#[derive(Debug)]
pub struct LeavingReader {
    count: wgpu::Buffer,
    keys: wgpu::Buffer,
    words: wgpu::Buffer,
    changed: wgpu::Buffer,
    block_words: usize,
}

/// Blocks that left the device.
#[derive(Clone, Debug, Default)]
pub struct Left {
    /// Where each lies.
    pub keys: Vec<BlockKey>,
    /// Their voxels one after the other, as [`HostBlock::words`].
    pub words: Vec<u32>,
    /// Of each the last frame that changed it; see [`crate::changed`]. Zero for those beyond its end.
    pub changed: Vec<u32>,
}

impl LeavingReader {
    /// The blocks; waits for the frame in which they left.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<Left, Error> {
        let count = u64::from(device.read_staging::<u32>(&self.count, 4)?[0]);
        if count == 0 {
            return Ok(Left::default());
        }
        let keys: Vec<[u32; 2]> = device.read_staging(&self.keys, count * 8)?;
        let words = device.read_staging(&self.words, count * self.block_words as u64 * 4)?;
        let changed = device.read_staging(&self.changed, count * 4)?;
        Ok(Left { keys: keys.into_iter().map(BlockKey::unpack).collect(), words, changed })
    }
}

/// Which of the blocks that were brought found room, on its way to the host.
#[derive(Debug)]
pub struct PlacesReader {
    staging: wgpu::Buffer,
    count: u32,
}

impl PlacesReader {
    /// Whether each block, in the order in which they were brought, is on the device now. Waits for the frame.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(self, device: &Device) -> Result<Vec<bool>, Error> {
        let places: Vec<u32> = device.read_staging(&self.staging, u64::from(self.count) * 4)?;
        Ok(places.into_iter().map(|place| place != 0).collect())
    }
}

impl Swap {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            age: Pipeline::plain(device, &swap::age::PASS),
            select: Pipeline::plain(device, &swap::select::PASS),
            scan: Scan::new(device),
            list: Pipeline::plain(device, &swap::list::PASS),
            gather: Gather::new(device),
            empty: Default::default(),
            count: Pipeline::plain(device, &swap::count::PASS),
            place: Pipeline::plain(device, &swap::place::PASS),
            merge: Default::default(),
            hash: Hash::new(device),
            ages: device.storage("ages", AGE_BINS as u64 * 4),
            unused_dispatch: device.storage("unused dispatch", 16),
        }
    }

    /// Records noting which blocks a view reaches, between two depths and with a margin (metres), and counting the others'
    /// ages. Frames are numbered from 1.
    #[expect(clippy::too_many_arguments, reason = "a view, its bounds, and when it was")]
    pub fn record_ages(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        [near_m, far_m]: [f32; 2],
        margin_m: f32,
        frame: u32,
    ) -> AgesReader {
        recorder.stage("swap");
        recorder.clear(&self.ages, self.ages.size());
        let bindings = swap::age::Bindings {
            params: swap::age::Params {
                frustum: frustum(camera, world_from_camera, [near_m, far_m], margin_m),
                map: map.params(),
                frame,
                unused_a: 0,
                unused_b: [0; 2],
            },
            counters: &map.counters,
            keys: &map.keys,
            last_seen: &map.last_seen,
            ages: &self.ages,
        };
        recorder.dispatch(&self.age, &bindings, Groups::linear(map.capacity().into(), 64));
        let staging = self.device.staging("ages", self.ages.size());
        recorder.copy(&self.ages, &staging, self.ages.size());
        AgesReader { staging }
    }

    /// Records the leaving of blocks that no view has reached for `least_age` frames as of `frame`, the first `most` by their
    /// indices: the result reads them once it has been done. The grid is stale afterwards.
    pub fn record_leaving(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        transfer: &Transfer,
        frame: u32,
        least_age: u32,
        most: u32,
    ) -> LeavingReader {
        self.list_leaving(recorder, map, transfer, frame, least_age, most);
        let kind = map.layout().kind;
        self.gather.record_voxels(recorder, map, &transfer.listed, &transfer.count, transfer.room, &transfer.words);
        let (listed, count) = (&transfer.listed, &transfer.count);
        self.gather.record_words(recorder, &map.last_changed, listed, count, transfer.room, &transfer.changed);
        let most = u64::from(most.min(transfer.room));
        let copy = |recorder: &mut Recorder, from: &wgpu::Buffer, bytes: u64| {
            let staging = self.device.staging("leaving blocks", bytes.max(4));
            recorder.copy(from, &staging, bytes);
            staging
        };
        let reader = LeavingReader {
            count: copy(recorder, &transfer.count, 4),
            keys: copy(recorder, &transfer.keys, most * 8),
            words: copy(recorder, &transfer.words, most * kind.block_bytes()),
            changed: copy(recorder, &transfer.changed, most * 4),
            block_words: kind.block_words(),
        };
        self.hash.remove_listed(recorder, map, &transfer.listed, &transfer.count, transfer.room);
        reader
    }

    /// The same, but the blocks are gone for good.
    pub fn record_deletion(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        transfer: &Transfer,
        frame: u32,
        least_age: u32,
        most: u32,
    ) {
        self.list_leaving(recorder, map, transfer, frame, least_age, most);
        self.hash.remove_listed(recorder, map, &transfer.listed, &transfer.count, transfer.room);
    }

    /// Records the removal of those of the visible blocks that hold nothing: no voxel that was seen near a surface or behind
    /// one. At most as many as a transfer holds. The grid and the visible list are stale afterwards.
    pub fn record_emptied(&self, recorder: &mut Recorder, map: &BlockMap, transfer: &Transfer) {
        recorder.stage("swap");
        let chunks = map.capacity().div_ceil(32);
        recorder.clear(&map.visible_bits, map.visible_bits.size());
        let which = usize::from(map.layout().kind.distance == DistanceKind::F32);
        let pipeline = self.empty[which]
            .get_or_init(|| Pipeline::new(&self.device, &swap::empty::PASS, map.distance_features(), &[]));
        for (distances, page) in map.distances().iter().zip(0..) {
            let bindings = swap::empty::Bindings {
                params: swap::empty::Params { page, page_shift: map.page_shift() },
                counters: &map.counters,
                visible: &map.visible,
                distances,
                bits: &map.visible_bits,
            };
            recorder.dispatch(pipeline, &bindings, Groups::linear(map.capacity().into(), 64));
        }
        let bindings = swap::count::Bindings {
            params: swap::count::Params { chunks },
            bits: &map.visible_bits,
            counts: &map.visible_counts,
        };
        recorder.dispatch(&self.count, &bindings, Groups::linear(chunks.into(), 64));
        self.list_marked(recorder, map, transfer, transfer.room);
        self.hash.remove_listed(recorder, map, &transfer.listed, &transfer.count, transfer.room);
    }

    fn list_leaving(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        transfer: &Transfer,
        frame: u32,
        least_age: u32,
        most: u32,
    ) {
        recorder.stage("swap");
        let chunks = map.capacity().div_ceil(32);
        let bindings = swap::select::Bindings {
            params: swap::select::Params { frame, least_age: least_age.max(1), chunks, unused: 0 },
            counters: &map.counters,
            keys: &map.keys,
            last_seen: &map.last_seen,
            // `visible` makes them anew each time.
            bits: &map.visible_bits,
            counts: &map.visible_counts,
        };
        recorder.dispatch(&self.select, &bindings, Groups::linear(chunks.into(), 64));
        self.list_marked(recorder, map, transfer, most);
    }

    /// Lists the blocks that are marked in the map's bits, and counted.
    fn list_marked(&self, recorder: &mut Recorder, map: &BlockMap, transfer: &Transfer, most: u32) {
        let chunks = map.capacity().div_ceil(32);
        let total = Total {
            counters: &transfer.count,
            slot: 0,
            indirect: &self.unused_dispatch,
            indirect_slot: 0,
            per_group: 1,
        };
        self.scan.record(recorder, &map.visible_counts, chunks, &total);
        let bindings = swap::list::Bindings {
            params: swap::list::Params { chunks, room: most.min(transfer.room) },
            bits: &map.visible_bits,
            offsets: &map.visible_counts,
            keys: &map.keys,
            listed: &transfer.listed,
            listed_keys: &transfer.keys,
            count: &transfer.count,
        };
        recorder.dispatch(&self.list, &bindings, Groups::linear(chunks.into(), 64));
    }

    /// Uploads blocks, as many as the transfer buffer holds; `allocate` makes room for them, [`Swap::record_merge`] puts them
    /// there. They must lie within the grid.
    pub fn bring(&self, transfer: &Transfer, blocks: &[HostBlock<'_>]) -> Arrivals {
        let blocks = &blocks[..blocks.len().min(transfer.room as usize)];
        let keys: Vec<[u32; 2]> = blocks.iter().map(|b| b.key.pack()).collect();
        let words: Vec<u32> = blocks.iter().flat_map(|b| b.words).copied().collect();
        self.device.queue.write_buffer(&transfer.keys, 0, bytemuck::cast_slice(&keys));
        self.device.queue.write_buffer(&transfer.words, 0, bytemuck::cast_slice(&words));
        Arrivals { transfer: transfer.clone(), count: blocks.len() as u32 }
    }

    /// Records fusing blocks that were brought with what the map holds at their places.
    pub fn record_merge(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        arrivals: &Arrivals,
        max_weight: u16,
    ) -> PlacesReader {
        recorder.stage("swap");
        let Arrivals { transfer, count } = arrivals;
        let count = *count;
        let bindings = swap::place::Bindings {
            params: swap::place::Params { map: map.params(), count, unused_a: 0, unused_b: [0; 2] },
            arriving: &transfer.keys,
            cells: &map.grid,
            places: &transfer.listed,
        };
        recorder.dispatch(&self.place, &bindings, Groups::linear(count.into(), 64));
        let kind = map.layout().kind;
        let mut plane_start = 0;
        for (plane, index) in map.planes.iter().zip(0..) {
            let (slot, features): (usize, &[&str]) = match (index, kind.distance) {
                (0, DistanceKind::I16) => (2, &["distances"]),
                (0, DistanceKind::F32) => (3, &["f32", "distances"]),
                (1, _) if kind.colour => (0, &[]),
                _ => (1, &["confidences"]),
            };
            let pipeline =
                self.merge[slot].get_or_init(|| Pipeline::new(&self.device, &swap::merge::PASS, features, &[]));
            for (voxels, page) in plane.pages.iter().zip(0..) {
                let bindings = swap::merge::Bindings {
                    params: swap::merge::Params {
                        count,
                        page,
                        page_shift: map.page_shift(),
                        plane_start,
                        block_words: kind.block_words() as u32,
                        max_weight: max_weight.into(),
                        unused: [0; 2],
                    },
                    places: &transfer.listed,
                    transfer: &transfer.words,
                    voxels,
                };
                recorder.dispatch(pipeline, &bindings, Groups::linear(count.into(), 1));
            }
            plane_start += plane.block_words() as u32;
        }
        let staging = self.device.staging("places", u64::from(count) * 4);
        recorder.copy(&transfer.listed, &staging, u64::from(count) * 4);
        PlacesReader { staging, count }
    }
}

/// Blocks that are read at a time.
const READ_AT_ONCE: usize = 1024;

/// Copies blocks out of a map.
#[derive(Debug)]
pub struct Gather {
    device: Device,
    gather: Pipeline,
}

impl Gather {
    /// Compiles the pass.
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), gather: Pipeline::plain(device, &swap::gather::PASS) }
    }

    /// Reads blocks by their indices, one behind the other into `words`, which is as long as they need (see
    /// [`HostBlock::words`]). All must be in use. The map stays as it is. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    ///
    /// # Panics
    /// Where `words` has another length.
    pub fn read(&self, map: &BlockMap, blocks: &[u32], words: &mut [u32]) -> Result<(), Error> {
        let block_words = map.layout().kind.block_words();
        assert_eq!(words.len(), blocks.len() * block_words, "words of {} blocks", blocks.len());
        let room = blocks.len().min(READ_AT_ONCE);
        if room == 0 {
            return Ok(());
        }
        let bytes = room as u64 * map.layout().kind.block_bytes();
        let listed = self.device.storage("read blocks", room as u64 * 4);
        let count = self.device.storage("read count", 16);
        let voxels = self.device.storage("read voxels", bytes);
        for (some, words) in blocks.chunks(room).zip(words.chunks_mut(room * block_words)) {
            self.device.queue.write_buffer(&listed, 0, bytemuck::cast_slice(some));
            self.device.queue.write_buffer(&count, 0, bytemuck::bytes_of(&(some.len() as u32)));
            let mut recorder = Recorder::new(&self.device);
            recorder.stage("swap");
            self.record_voxels(&mut recorder, map, &listed, &count, room as u32, &voxels);
            let _untimed = recorder.submit();
            words.copy_from_slice(&self.device.read::<u32>(&voxels, 0, size_of_val(words) as u64)?);
        }
        Ok(())
    }

    /// Records copying the voxels of listed blocks, each block's planes one after the other.
    fn record_voxels(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        listed: &wgpu::Buffer,
        count: &wgpu::Buffer,
        room: u32,
        to: &wgpu::Buffer,
    ) {
        let block_words = map.layout().kind.block_words() as u32;
        let mut plane_start = 0;
        for plane in &map.planes {
            let plane_words = plane.block_words() as u32;
            for (words, page) in plane.pages.iter().zip(0..) {
                let part = Part { page, page_shift: map.page_shift(), plane_words, plane_start, block_words };
                self.record(recorder, part, words, listed, count, room, to);
            }
            plane_start += plane_words;
        }
    }

    /// Records copying what a table has of listed blocks, one word each.
    fn record_words(
        &self,
        recorder: &mut Recorder,
        table: &wgpu::Buffer,
        listed: &wgpu::Buffer,
        count: &wgpu::Buffer,
        room: u32,
        to: &wgpu::Buffer,
    ) {
        // A table is one page, whatever it has.
        let part = Part { page: 0, page_shift: 31, plane_words: 1, plane_start: 0, block_words: 1 };
        self.record(recorder, part, table, listed, count, room, to);
    }

    #[expect(clippy::too_many_arguments, reason = "a list of blocks, what is copied of each, and from where to where")]
    fn record(
        &self,
        recorder: &mut Recorder,
        part: Part,
        plane: &wgpu::Buffer,
        listed: &wgpu::Buffer,
        count: &wgpu::Buffer,
        room: u32,
        to: &wgpu::Buffer,
    ) {
        let Part { page, page_shift, plane_words, plane_start, block_words } = part;
        let params = swap::gather::Params {
            page,
            page_shift,
            plane_words,
            plane_start,
            block_words,
            unused_a: 0,
            unused_b: [0; 2],
        };
        let bindings = swap::gather::Bindings { params, listed, count, plane, transfer: to };
        recorder.dispatch(&self.gather, &bindings, Groups::linear(u64::from(room).min(GATHERED_AT_ONCE), 1));
    }
}

/// What is copied of each block out of one page, in words.
struct Part {
    page: u32,
    page_shift: u32,
    plane_words: u32,
    plane_start: u32,
    block_words: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_of_ages_follow_one_another() {
        // As `shared/ages.wgsl` sorts them.
        let bin = |age: u32| {
            let shift = age.ilog2().max(2) - 2;
            (4 * shift + (age >> shift)) as usize
        };
        for age in 1..5_000 {
            let found = bin(age);
            assert!(age_of_bin(found) <= age && age < age_of_bin(found + 1), "{age} in {found}");
        }
    }
}
