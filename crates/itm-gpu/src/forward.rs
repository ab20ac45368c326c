//! Stage `forward`: the points of the frame before, seen from this frame's pose (the report, section 3.4, where it says that a
//! raycast may be approximated). Rays are cast only for the pixels that no point falls into.

use itm_core::{Intrinsics, Se3};
use itm_shaders::forward;

use crate::map::camera_params;
use crate::raycast::RayList;
use crate::recorder::{Groups, Pipeline};
use crate::{Device, RaycastImage, Recorder};

/// The stage's pipelines and what it remembers of the frame before, for images of one size.
#[derive(Debug)]
pub struct Forward {
    project: Pipeline,
    choose: Pipeline,
    fill: Pipeline,
    before: wgpu::Buffer,
    targets: wgpu::Buffer,
    nearest: wgpu::Buffer,
    chosen: wgpu::Buffer,
    missing: RayList,
}

impl Forward {
    /// Prepares the stage for images of a camera's size.
    pub fn new(device: &Device, camera: &Intrinsics) -> Self {
        let pixels = camera.pixels() as u64;
        Self {
            project: Pipeline::plain(device, &forward::project::PASS),
            choose: Pipeline::plain(device, &forward::choose::PASS),
            fill: Pipeline::plain(device, &forward::fill::PASS),
            before: device.storage("points before", pixels * 16),
            targets: device.storage("targets", pixels * 8),
            nearest: device.storage("nearest", pixels * 4),
            chosen: device.storage("chosen", pixels * 4),
            missing: RayList::new(device, pixels),
        }
    }

    /// Records that the image's points move to where its camera sees them from another pose: each pixel gets the nearest
    /// point that falls into it, within a range of depths. A point stays where it is in the world, and so does what is
    /// known of it. What [`crate::raycast::Raycast::record_listed`] has to cast is returned: the pixels without a point.
    ///
    /// # Panics
    /// Where the image has not as many pixels as the one that the stage was prepared for.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        image: &RaycastImage,
        world_from_camera: &Se3,
        depth_range_m: [f32; 2],
    ) -> &RayList {
        let pixels = image.camera().pixels() as u32;
        assert_eq!(u64::from(pixels) * 16, self.before.size().min(image.points.size()), "an image of another size");
        recorder.stage("forward");
        recorder.copy(&image.points, &self.before, u64::from(pixels) * 16);
        recorder.clear(&self.nearest, u64::from(pixels) * 4);
        recorder.clear(&self.chosen, u64::from(pixels) * 4);
        self.missing.record_clear(recorder);
        let groups = Groups::linear(pixels.into(), 64);
        let bindings = forward::project::Bindings {
            params: forward::project::Params {
                camera: camera_params(image.camera(), depth_range_m),
                camera_from_world: world_from_camera.inverse().to_mat4().to_cols_array_2d(),
            },
            before: &self.before,
            targets: &self.targets,
            nearest: &self.nearest,
        };
        recorder.dispatch(&self.project, &bindings, groups);
        let bindings = forward::choose::Bindings {
            params: forward::choose::Params { pixels },
            targets: &self.targets,
            nearest: &self.nearest,
            chosen: &self.chosen,
        };
        recorder.dispatch(&self.choose, &bindings, groups);
        let bindings = forward::fill::Bindings {
            params: forward::fill::Params { pixels },
            before: &self.before,
            chosen: &self.chosen,
            points: &image.points,
            missing: &self.missing.words,
        };
        recorder.dispatch(&self.fill, &bindings, groups);
        &self.missing
    }
}
