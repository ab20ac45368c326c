//! Stage `confidence`: how well the points of a raycast image are known, where the map keeps that.
//!
//! A voxel's confidence is the sum of its observations' qualities, up to the largest weight: each is the variance of a
//! Kinect's depth at its best by that at the depth measured (Nguyen et al. 2012, *Modeling Kinect Sensor Noise for Improved
//! 3D Reconstruction and Tracking*), times the cosine of the angle between ray and surface (Newcombe et al. 2011, section
//! 3.3). So it says how many of the best observations would tell as much; `integrate` keeps it.

use std::sync::OnceLock;

use itm_shaders::confidence;

use crate::raycast::page_features;
use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Device, RaycastImage, Recorder};

/// The stage's pipelines, compiled when first needed: one for each number of pages.
#[derive(Debug)]
pub struct Confidence {
    device: Device,
    variants: [OnceLock<Pipeline>; 4],
}

impl Confidence {
    /// Prepares the stage.
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), variants: Default::default() }
    }

    /// Records the stage for an image that was cast from the map, with normals; nothing where the map has no confidence.
    pub fn record(&self, recorder: &mut Recorder, map: &BlockMap, image: &RaycastImage) {
        let pages = map.confidences();
        let Some(plane0) = pages.first() else { return };
        recorder.stage("confidence");
        let pipeline = self.variants[pages.len() - 1]
            .get_or_init(|| Pipeline::new(&self.device, &confidence::PASS, page_features(pages.len()), &[]));
        let pixels = image.camera().pixels() as u32;
        let bindings = confidence::Bindings {
            params: confidence::Params { map: map.params(), pixels, unused_a: 0, unused_b: [0; 2] },
            points: &image.points,
            normals: &image.normals,
            plane0,
            plane1: pages.get(1),
            plane2: pages.get(2),
            plane3: pages.get(3),
            grid: &map.grid,
        };
        recorder.dispatch(pipeline, &bindings, Groups::linear(pixels.into(), 64));
    }
}
