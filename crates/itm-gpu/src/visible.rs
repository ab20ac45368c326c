//! Stage `visible`: the list of blocks in the view's frustum, in the order of their indices (the report, section 3.2).

use glam::DVec3;
use itm_core::{Intrinsics, Se3};
use itm_shaders::visible;

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
                camera_from_world: world_from_camera.inverse().to_mat4().to_cols_array_2d(),
                sides: frustum_sides(camera),
                map: map.params(),
                near_m,
                far_m,
                chunks,
                unused: 0,
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

/// Inward unit normals of the planes through the camera's centre and the image's four sides (camera frame).
fn frustum_sides(camera: &Intrinsics) -> [[f32; 4]; 4] {
    let (w, h) = (f64::from(camera.width) - 0.5, f64::from(camera.height) - 0.5);
    let corner = |x, y| camera.unproject(glam::DVec2::new(x, y), 1.0);
    let corners = [corner(-0.5, -0.5), corner(w, -0.5), corner(w, h), corner(-0.5, h)];
    let middle = corners.iter().sum::<DVec3>();
    std::array::from_fn(|i| {
        let normal = corners[i].cross(corners[(i + 1) % 4]).normalize();
        let inward = if normal.dot(middle) < 0.0 { -normal } else { normal };
        inward.extend(0.0).as_vec4().to_array()
    })
}
