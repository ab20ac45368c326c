//! Camera tracking: the optimisation of a pose over an objective that the GPU (or a CPU reference) evaluates.
//!
//! A tracker meets images only through [`Objective`]. [`Plan`] says what a kind of tracker evaluates at which level, one
//! optimiser (`optimise`) carries every plan out, [`Motion`] says where to start, and a verdict says whether the result
//! can be relied on.

mod classifier;
mod equations;
mod motion;
mod on_gpu;
mod optimise;
mod plan;
mod tracker;
mod verdict;

use itm_core::Se3;
use itm_gpu::icp::DepthTerm;
use itm_gpu::photometric::PhotometricTerm;
use itm_gpu::{DepthSums, PhotometricSums};
use serde::{Deserialize, Serialize};

pub(crate) use classifier::CHECK_LEVELS;
pub use classifier::{Classifier, FEATURES, Features, Regression, SEEN_FEATURES, terms};
pub use equations::{Noise, NormalEquations};
pub use motion::Motion;
pub(crate) use on_gpu::{ModelObjective, colour_offset};
pub(crate) use optimise::optimise_each;
pub use optimise::{Outcome, optimise};
pub use plan::{Age, LevelPlan, Part, Plan};
pub use tracker::{Learnt, Moment, Tracker};
pub use verdict::{Tracked, Verdict};

/// What a colour is multiplied by, and what is added then, to become what another image shows: the difference between two
/// exposures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Factor.
    pub gain: f64,
    /// Summand; colours are 0 to 1.
    pub offset: f64,
}

impl Default for Exposure {
    fn default() -> Self {
        Self { gain: 1.0, offset: 0.0 }
    }
}

/// What live colours are compared with: an index into a guess's exposures and an evaluation's colour sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Against {
    /// The frame before.
    Previous = 0,
    /// The map.
    Map = 1,
}

/// What is estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guess {
    /// Pose of the depth camera.
    pub world_from_camera: Se3,
    /// Exposures of what live colours are compared with, by [`Against`].
    pub exposure: [Exposure; 2],
}

impl Guess {
    /// A pose, with exposures that are alike.
    pub fn at(world_from_camera: Se3) -> Self {
        Self { world_from_camera, ..Self::default() }
    }
}

/// What is to be evaluated; a term's gain and offset are the guess's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Level of the pyramids; 0 is the finest.
    pub level: usize,
    /// The depth term.
    pub depth: Option<DepthTerm>,
    /// The colour terms, by [`Against`].
    pub colour: [Option<PhotometricTerm>; 2],
}

/// What an objective finds: a term that was not asked for, or has no data to compare, has no sums.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// The depth term.
    pub depth: Option<DepthSums>,
    /// The colour terms, by [`Against`].
    pub colour: [Option<PhotometricSums>; 2],
}

/// Error terms over a frame's pixels, as functions of the camera's pose.
pub trait Objective {
    /// Point (world frame, metres) about which the sums' rotation turns.
    fn pivot(&self) -> glam::DVec3;

    /// The sums at a guess.
    ///
    /// # Errors
    /// Where the device was lost.
    fn evaluate(&mut self, guess: &Guess, request: &Request) -> Result<Evaluation, itm_gpu::Error>;

    /// The sums at each of several guesses; the same as one after the other, but it may wait less.
    ///
    /// # Errors
    /// As [`Objective::evaluate`].
    fn evaluate_all(&mut self, guesses: &[Guess], request: &Request) -> Result<Vec<Evaluation>, itm_gpu::Error> {
        guesses.iter().map(|guess| self.evaluate(guess, request)).collect()
    }
}
