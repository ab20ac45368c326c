//! Stage `visible`: the list of blocks in the view's frustum, in the order of their indices (the report, section 3.2).

use itm_core::{Intrinsics, Se3};
use itm_shaders::{types, visible};

use crate::map::{counter, indirect};
use crate::recorder::{Groups, Pipeline};
use crate::scan::{Scan, Total};
use crate::{BlockMap, Device, Recorder};

/// Blocks that one workgroup of `integrate` takes; its indirect dispatch is made here.
pub(crate) const BLOCKS_PER_GROUP: u32 = 8;

/// The stage's pipelines.
#[derive(Debug)]
pub struct Visible {
    test: Pipeline,
    scan: Scan,
    write: Pipeline,
}

impl Visible {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            test: Pipeline::plain(device, &visible::test::PASS),
            scan: Scan::new(device),
            write: Pipeline::plain(device, &visible::write::PASS),
        }
    }

    /// Records the stage for a camera at a pose; depths in metres.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        near_m: f32,
        far_m: f32,
    ) {
        recorder.stage("visible");
        let chunks = map.capacity().div_ceil(32);
        let bindings = visible::test::Bindings {
            params: visible::test::Params {
                frustum: frustum(camera, world_from_camera, [near_m, far_m], 0.0),
                map: map.params(),
                chunks,
                unused_a: 0,
                unused_b: [0; 2],
            },
            counters: &map.counters,
            keys: &map.keys,
            bits: &map.visible_bits,
            counts: &map.visible_counts,
        };
        recorder.dispatch(&self.test, &bindings, Groups::linear(chunks.into(), 64));
        let total = Total {
            counters: &map.counters,
            slot: counter::VISIBLE,
            indirect: &map.indirect,
            indirect_slot: indirect::VISIBLE,
            per_group: BLOCKS_PER_GROUP,
        };
        self.scan.record(recorder, &map.visible_counts, chunks, &total);
        let bindings = visible::write::Bindings {
            params: visible::write::Params { chunks },
            bits: &map.visible_bits,
            offsets: &map.visible_counts,
            visible: &map.visible,
        };
        recorder.dispatch(&self.write, &bindings, Groups::linear(chunks.into(), 64));
    }
}

impl BlockMap {
    /// Reads the visible list back. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read_visible(&self, device: &Device) -> Result<Vec<u32>, crate::Error> {
        match self.read_record()?.visible {
            0 => Ok(Vec::new()),
            count => device.read(&self.visible, 0, u64::from(count) * 4),
        }
    }
}

/// A view's frustum between two depths, with a margin around it, as shaders see it.
pub(crate) fn frustum(
    camera: &Intrinsics,
    world_from_camera: &Se3,
    [near_m, far_m]: [f32; 2],
    margin_m: f32,
) -> types::Frustum {
    types::Frustum {
        camera_from_world: world_from_camera.inverse().to_mat4().to_cols_array_2d(),
        sides: camera.frustum_sides().map(|side| side.extend(0.0).as_vec4().to_array()),
        near_m,
        far_m,
        margin_m,
        unused: 0.0,
    }
}
