//! Stage `changed`: which frame last changed each block, so that a program can follow the map without looking at all of it.
//!
//! A block counts as changed by a frame where it was in the frame's view when that was fused, whether or not one of its voxels
//! became another, or where it came back from the host and met another one there. Frames are numbered from 1.

use itm_core::voxel::BlockKey;
use itm_shaders::changed;

use crate::recorder::{Groups, Pipeline};
use crate::swap::Arrivals;
use crate::{BlockMap, Device, Error, Recorder};

/// The stage's pipelines.
#[derive(Debug)]
pub struct Changed {
    device: Device,
    mark: Pipeline,
    arrive: Pipeline,
}

impl Changed {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            mark: Pipeline::plain(device, &changed::mark::PASS),
            arrive: Pipeline::plain(device, &changed::arrive::PASS),
        }
    }

    /// Records that a frame has changed the visible blocks.
    pub fn record(&self, recorder: &mut Recorder, map: &BlockMap, frame: u32) {
        recorder.stage("changed");
        let bindings = changed::mark::Bindings {
            params: changed::mark::Params { frame },
            counters: &map.counters,
            visible: &map.visible,
            last_changed: &map.last_changed,
        };
        recorder.dispatch(&self.mark, &bindings, Groups::linear(map.capacity().into(), 64));
    }

    /// Records when blocks that came back, and were merged, had been changed: `changed` has a frame for each of them, in the
    /// order in which they were brought.
    pub fn record_arrivals(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        arrivals: &Arrivals,
        changed: &[u32],
        frame: u32,
    ) {
        let changed = &changed[..changed.len().min(arrivals.count() as usize)];
        if changed.is_empty() {
            return;
        }
        self.device.queue.write_buffer(arrivals.changed(), 0, bytemuck::cast_slice(changed));
        recorder.stage("changed");
        let bindings = changed::arrive::Bindings {
            params: changed::arrive::Params { count: changed.len() as u32, frame },
            places: arrivals.places(),
            changed: arrivals.changed(),
            last_changed: &map.last_changed,
        };
        recorder.dispatch(&self.arrive, &bindings, Groups::linear(changed.len() as u64, 64));
    }
}

impl BlockMap {
    /// The blocks that frames after one have changed, with the last that did. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_changed_since(&self, frame: u32) -> Result<Vec<(BlockKey, u32)>, Error> {
        let keys = self.read_keys()?;
        if keys.is_empty() {
            return Ok(Vec::new());
        }
        let changed: Vec<u32> = self.device().read(&self.last_changed, 0, keys.len() as u64 * 4)?;
        let both = keys.into_iter().zip(changed);
        Ok(both.filter(|(_, changed)| *changed > frame).filter_map(|(key, changed)| Some((key?, changed))).collect())
    }
}
