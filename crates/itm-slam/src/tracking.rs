//! Camera tracking: the optimisation of a pose over an objective that the GPU (or a CPU reference) evaluates.
//!
//! A tracker meets images only through [`Objective`]; it solves six-by-six systems and decides whether a frame was
//! tracked. The family of trackers grows here, one module each.

pub mod icp;

use itm_core::Se3;
pub use itm_gpu::icp::NormalEquations;

/// A sum of squared residuals over a frame's pixels, as a function of the camera's pose.
pub trait Objective {
    /// Levels of the image pyramid; 0 is the finest.
    fn levels(&self) -> usize;

    /// Point (world frame, metres) about which the equations' rotation turns.
    fn pivot(&self) -> glam::DVec3;

    /// The normal equations at a pose, for pairs at most `max_distance_m` apart.
    ///
    /// # Errors
    /// Where the device was lost.
    fn evaluate(
        &mut self,
        world_from_camera: &Se3,
        level: usize,
        max_distance_m: f32,
    ) -> Result<NormalEquations, itm_gpu::Error>;
}

/// Whether a frame was tracked.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// The pose can be relied on.
    Good,
    /// There is no pose, for this reason.
    Lost {
        /// In words and numbers.
        reason: String,
    },
}

/// What tracking found.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracked {
    /// The camera's pose; where tracking was lost, the one it started from. Always finite.
    pub world_from_camera: Se3,
    /// Whether it can be relied on.
    pub verdict: Verdict,
    /// Pairs at the last evaluation of the finest level that was used.
    pub inliers: u32,
    /// Pairs as a share of the pixels with a depth.
    pub inlier_share: f64,
    /// Root mean square distance of the pairs, in metres.
    pub rms_m: f64,
    /// Evaluations of the objective, from the coarsest level to the finest.
    pub evaluations: Vec<u32>,
}
