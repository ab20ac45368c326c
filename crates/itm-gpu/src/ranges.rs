//! Stage `ranges`: where along each ray a surface may lie, from the visible blocks (the report, section 3.4). One pixel
//! for 8x8 of the view; blocks are cut into fragments of 16x16 such pixels, numbered by prefix sum.

use itm_core::{Intrinsics, Se3};
use itm_shaders::ranges;

use crate::map::{camera_params, counter, indirect};
use crate::recorder::{Groups, Pipeline};
use crate::scan::{Scan, Total};
use crate::{BlockMap, Device, RaycastImage, Recorder};

/// The stage's pipelines.
#[derive(Debug)]
pub struct Ranges {
    project: Pipeline,
    scan: Scan,
    fill: Pipeline,
}

/// Width and height of the range image for an image of a size.
pub(crate) fn range_size(camera: &Intrinsics) -> [u32; 2] {
    [camera.width.div_ceil(8), camera.height.div_ceil(8)]
}

impl Ranges {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            project: Pipeline::plain(device, &ranges::project::PASS),
            scan: Scan::new(device),
            fill: Pipeline::plain(device, &ranges::fill::PASS),
        }
    }

    /// Records the stage for the map's visible list, as seen by the image's camera from a pose.
    pub fn record(&self, recorder: &mut Recorder, map: &BlockMap, image: &RaycastImage, world_from_camera: &Se3) {
        recorder.stage("ranges");
        let size = range_size(image.camera());
        recorder.clear(&image.ranges, u64::from(size[0]) * u64::from(size[1]) * 8);
        let capacity = map.capacity();
        let bindings = ranges::project::Bindings {
            params: ranges::project::Params {
                camera: camera_params(image.camera(), [0.0, 0.0]),
                camera_from_world: world_from_camera.inverse().to_mat4().to_cols_array_2d(),
                map: map.params(),
                range_size: size,
                capacity,
                unused: 0,
            },
            counters: &map.counters,
            visible: &map.visible,
            keys: &map.keys,
            boxes: &map.boxes,
            counts: &map.fragment_counts,
        };
        recorder.dispatch(&self.project, &bindings, Groups::linear(capacity.into(), 64));
        let total = Total {
            counters: &map.counters,
            slot: counter::FRAGMENTS,
            indirect: &map.indirect,
            indirect_slot: indirect::FRAGMENTS,
            per_group: 64,
        };
        self.scan.record(recorder, &map.fragment_counts, capacity, &total);
        let bindings = ranges::fill::Bindings {
            params: ranges::fill::Params { range_size: size, blocks: capacity, unused: 0 },
            counters: &map.counters,
            boxes: &map.boxes,
            offsets: &map.fragment_counts,
            ranges: &image.ranges,
        };
        recorder.dispatch(&self.fill, &bindings, Groups::Indirect(&map.indirect, indirect::FRAGMENTS));
    }
}
