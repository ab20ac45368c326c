//! What a camera sees of a map: the stages from the grid around the view to points, normals and confidences.

use itm_core::{Intrinsics, Se3};
use itm_gpu::allocate::Allocate;
use itm_gpu::confidence::Confidence;
use itm_gpu::forward::Forward;
use itm_gpu::normals::Normals;
use itm_gpu::ranges::Ranges;
use itm_gpu::raycast::Raycast;
use itm_gpu::visible::Visible;
use itm_gpu::{BlockMap, Device, RaycastImage, Recorder};

/// Nearest depth that is seen, in metres.
pub(crate) const NEAR_M: f32 = 0.01;

/// The stages that show a map.
#[derive(Debug)]
pub(crate) struct Caster {
    pub(crate) allocate: Allocate,
    pub(crate) visible: Visible,
    ranges: Ranges,
    raycast: Raycast,
    normals: Normals,
    confidence: Confidence,
}

impl Caster {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            allocate: Allocate::new(device),
            visible: Visible::new(device),
            ranges: Ranges::new(device),
            raycast: Raycast::new(device),
            normals: Normals::new(device),
            confidence: Confidence::new(device),
        }
    }

    /// Records what a camera sees from a pose up to a depth, around which the map's grid was laid.
    pub(crate) fn look(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        image: &RaycastImage,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) {
        self.find(recorder, map, image.camera(), world_from_camera, max_depth_m);
        self.cast(recorder, map, image, world_from_camera, [NEAR_M, max_depth_m]);
    }

    /// Records which blocks a camera sees from a pose up to a depth, around which the map's grid was laid.
    pub(crate) fn find(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        max_depth_m: f32,
    ) {
        self.allocate.fill_grid(recorder, map);
        self.visible.record(recorder, map, camera, world_from_camera, 0.0, max_depth_m);
    }

    /// Records a ray for each pixel, through the blocks that were found to be visible.
    pub(crate) fn cast(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        image: &RaycastImage,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) {
        self.ranges.record(recorder, map, image, world_from_camera);
        self.raycast.record(recorder, map, image, world_from_camera, depth_range_m);
        self.complete(recorder, map, image, world_from_camera);
    }

    /// Records that the image's points are projected forward to a pose, and a ray for each pixel that none falls into.
    pub(crate) fn cast_forward(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        image: &RaycastImage,
        forward: &Forward,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) {
        self.ranges.record(recorder, map, image, world_from_camera);
        let missing = forward.record(recorder, image, world_from_camera, depth_range_m);
        self.raycast.record_listed(recorder, map, image, missing, world_from_camera, depth_range_m);
        self.complete(recorder, map, image, world_from_camera);
    }

    /// Records what is made of an image's points.
    fn complete(&self, recorder: &mut Recorder, map: &BlockMap, image: &RaycastImage, world_from_camera: &Se3) {
        self.normals.record(recorder, image, world_from_camera);
        self.confidence.record(recorder, map, image);
    }
}
