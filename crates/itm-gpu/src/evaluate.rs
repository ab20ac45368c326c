//! Evaluating a pose: the sums of every error term at once, with one wait.

use itm_core::Se3;

use crate::icp::{DepthTerm, Icp};
use crate::photometric::{Photometric, PhotometricTerm, PointList};
use crate::sums::{DepthSums, PhotometricSums, Reduce, SLOTS};
use crate::{Device, Error, RaycastImage, Recorder, View};

/// The frame and the surface that are compared.
#[derive(Clone, Copy, Debug)]
pub struct Compared<'a> {
    /// The frame.
    pub view: &'a View,
    /// Level of its depth pyramid; 0 is the finest.
    pub level: usize,
    /// The surface, as seen from `world_from_model`.
    pub model: &'a RaycastImage,
    /// Where it was cast from. The equations' pivot is this camera's centre.
    pub world_from_model: Se3,
}

/// A colour term: what it compares with, and where the live colour camera is.
#[derive(Clone, Copy, Debug)]
pub struct ColourTerm<'a> {
    /// Points with colours.
    pub list: &'a PointList,
    /// Pose of the live colour camera.
    pub world_from_colour: Se3,
    /// What counts, and how much.
    pub term: PhotometricTerm,
}

/// Runs the stages `icp` and `photometric`.
#[derive(Debug)]
pub struct Evaluator {
    device: Device,
    icp: Icp,
    /// Makes point lists, too.
    pub photometric: Photometric,
    reduce: Reduce,
}

impl Evaluator {
    /// Compiles the stages.
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            icp: Icp::new(device),
            photometric: Photometric::new(device),
            reduce: Reduce::new(device),
        }
    }

    /// The sums at a pose: those of the depth term, if any, and of up to two colour terms; a term without data to compare
    /// has none. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn evaluate(
        &mut self,
        compared: &Compared<'_>,
        world_from_camera: &Se3,
        depth: Option<&DepthTerm>,
        colour: [Option<&ColourTerm<'_>>; 2],
    ) -> Result<(Option<DepthSums>, [Option<PhotometricSums>; 2]), Error> {
        let Compared { view, level, model, world_from_model } = *compared;
        let mut recorder = Recorder::new(&self.device);
        if let Some(term) = depth {
            let to = (&mut self.reduce, 0);
            self.icp.record(&mut recorder, view, level, world_from_camera, model, &world_from_model, term, to);
        }
        let pivot = world_from_model.translation.as_vec3();
        let mut present = [false; 2];
        for (index, colour) in colour.into_iter().enumerate() {
            let Some(ColourTerm { list, world_from_colour, term }) = colour else { continue };
            let to = (&mut self.reduce, 1 + index);
            present[index] = self.photometric.record(&mut recorder, view, world_from_colour, list, pivot, term, to);
        }
        let sums = self.reduce.read(recorder, 3)?;
        let photometric = |index: usize| present[index].then(|| PhotometricSums::new(&sums[1 + index]));
        Ok((depth.map(|_| DepthSums::new(&sums[0])), [photometric(0), photometric(1)]))
    }

    /// The sums of the depth term at each of several poses (`world_from_camera`), as [`Evaluator::evaluate`] finds them and in the
    /// poses' order. Waits, but only once for every sixteen poses.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn evaluate_at(
        &mut self,
        compared: &Compared<'_>,
        poses: &[Se3],
        term: &DepthTerm,
    ) -> Result<Vec<DepthSums>, Error> {
        let Compared { view, level, model, world_from_model } = *compared;
        let mut found = Vec::new();
        for poses in poses.chunks(SLOTS) {
            let mut recorder = Recorder::new(&self.device);
            for (slot, pose) in poses.iter().enumerate() {
                let to = (&mut self.reduce, slot);
                self.icp.record(&mut recorder, view, level, pose, model, &world_from_model, term, to);
            }
            let sums = self.reduce.read(recorder, poses.len())?;
            found.extend(sums.iter().map(|sums| DepthSums::new(sums)));
        }
        Ok(found)
    }
}
