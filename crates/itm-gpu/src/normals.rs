//! Stage `normals`: normals of a raycast image, from neighbouring points (the report, section 3.4).

use itm_core::Se3;
use itm_shaders::normals;

use crate::recorder::{Groups, Pipeline};
use crate::{Device, RaycastImage, Recorder};

/// The stage's pipeline.
#[derive(Debug)]
pub struct Normals {
    pipeline: Pipeline,
}

impl Normals {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self { pipeline: Pipeline::plain(device, &normals::PASS) }
    }

    /// Records the stage for an image that was cast from a pose.
    pub fn record(&self, recorder: &mut Recorder, image: &RaycastImage, world_from_camera: &Se3) {
        recorder.stage("normals");
        let size = (image.camera().width, image.camera().height);
        let bindings = normals::Bindings {
            params: normals::Params {
                size: [size.0, size.1],
                unused: [0; 2],
                camera: world_from_camera.translation.as_vec3().extend(1.0).to_array(),
            },
            points: &image.points,
            normals: &image.normals,
        };
        recorder.dispatch(&self.pipeline, &bindings, Groups::image(size, (8, 8)));
    }
}
