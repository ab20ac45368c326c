//! Stage `hash`: looking blocks up by key, taking them out, rebuilding the hash.
//!
//! The hash is an open-addressed table of block indices (not of keys: a 64-bit key cannot be swapped atomically in
//! portable WGSL, an index can) with linear probing, at most half full. GPU.md's measurements favour it over ordered
//! buckets with an excess list: one path, no list to run out of. Insertion is part of `allocate`.

use itm_core::voxel::BlockKey;
use itm_shaders::hash;

use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Device, Error, Recorder};

/// Workgroups that clear blocks, one block at a time each: a list is rarely as long as it may be.
const CLEARED_AT_ONCE: u64 = 256;

/// The stage's pipelines.
#[derive(Debug)]
pub struct Hash {
    device: Device,
    lookup: Pipeline,
    remove: Pipeline,
    removed: Pipeline,
    clear: Pipeline,
    rebuild: Pipeline,
}

impl Hash {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            lookup: Pipeline::plain(device, &hash::lookup::PASS),
            remove: Pipeline::plain(device, &hash::remove::PASS),
            removed: Pipeline::plain(device, &hash::removed::PASS),
            clear: Pipeline::plain(device, &hash::clear::PASS),
            rebuild: Pipeline::plain(device, &hash::rebuild::PASS),
        }
    }

    /// The blocks with these keys, or `None` for those that the map does not hold. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn look_up(&self, map: &BlockMap, keys: &[BlockKey]) -> Result<Vec<Option<u32>>, Error> {
        if keys.is_empty() {
            return Ok(Vec::new());
        }
        let count = u32::try_from(keys.len()).expect("fewer keys than fit the device");
        let packed: Vec<[u32; 2]> = keys.iter().map(|k| k.pack()).collect();
        let wanted = self.device.storage("wanted", u64::from(count) * 8);
        self.device.queue.write_buffer(&wanted, 0, bytemuck::cast_slice(&packed));
        let found = self.device.storage("found", u64::from(count) * 4);
        let mut recorder = Recorder::new(&self.device);
        recorder.stage("hash");
        let bindings = hash::lookup::Bindings {
            params: hash::lookup::Params { map: map.params(), count, unused_a: 0, unused_b: [0; 2] },
            wanted: &wanted,
            found: &found,
            keys: &map.keys,
            hash: &map.hash,
        };
        recorder.dispatch(&self.lookup, &bindings, Groups::linear(count.into(), 64));
        let _untimed = recorder.submit();
        let found: Vec<u32> = self.device.read(&found, 0, u64::from(count) * 4)?;
        Ok(found.into_iter().map(|f| f.checked_sub(1)).collect())
    }

    /// Records the removal of blocks: their keys leave the hash, their voxels are zeroed, and they go to the free list in
    /// the order given. Each must be in use and named once. The grid is stale afterwards, until `allocate` fills it anew.
    pub fn remove(&self, recorder: &mut Recorder, map: &BlockMap, blocks: &[u32]) {
        if blocks.is_empty() {
            return;
        }
        let count = u32::try_from(blocks.len()).expect("fewer blocks than fit the device");
        let list = self.device.storage("removed blocks", u64::from(count) * 4);
        self.device.queue.write_buffer(&list, 0, bytemuck::cast_slice(blocks));
        let length = self.device.storage("removed count", 16);
        self.device.queue.write_buffer(&length, 0, bytemuck::bytes_of(&count));
        self.remove_listed(recorder, map, &list, &length, count);
    }

    /// The same for a list on the device, which names as many blocks as the first word of `count` says, at most `room`.
    pub(crate) fn remove_listed(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        list: &wgpu::Buffer,
        count: &wgpu::Buffer,
        room: u32,
    ) {
        recorder.stage("hash");
        let bindings = hash::remove::Bindings {
            params: hash::remove::Params { map: map.params() },
            blocks: list,
            counters: &map.counters,
            keys: &map.keys,
            free_blocks: &map.free_blocks,
            count,
            last_seen: &map.last_seen,
            last_changed: &map.last_changed,
            slots: &map.hash,
        };
        recorder.dispatch(&self.remove, &bindings, Groups::linear(room.into(), 64));
        let bindings = hash::removed::Bindings { counters: &map.counters, count };
        recorder.dispatch(&self.removed, &bindings, Groups::Count([1, 1, 1]));
        for plane in &map.planes {
            let block_words = plane.block_words() as u32;
            for (voxels, page) in plane.pages.iter().zip(0..) {
                let params = hash::clear::Params { page, page_shift: map.page_shift(), unused: 0, block_words };
                let bindings = hash::clear::Bindings { params, blocks: list, voxels, count };
                recorder.dispatch(&self.clear, &bindings, Groups::linear(u64::from(room).min(CLEARED_AT_ONCE), 1));
            }
        }
    }

    /// Records entering all blocks into an emptied hash.
    pub fn rebuild(&self, recorder: &mut Recorder, map: &BlockMap) {
        recorder.stage("hash");
        recorder.clear(&map.hash, map.hash.size());
        // No tombstone is left.
        recorder.clear_word(&map.counters, crate::map::counter::TOMBSTONES);
        let bindings = hash::rebuild::Bindings {
            params: hash::rebuild::Params { map: map.params() },
            counters: &map.counters,
            keys: &map.keys,
            slots: &map.hash,
        };
        recorder.dispatch(&self.rebuild, &bindings, Groups::linear(map.capacity().into(), 64));
    }
}
