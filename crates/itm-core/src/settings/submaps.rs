//! Maps of many submaps.

use serde::{Deserialize, Serialize};

use super::{SettingsError, check};

/// How the map is divided into submaps, and how their poses relative to each other are found (Kähler et al. 2016, *Real-Time
/// Large-Scale Dense 3D Reconstruction with Loop Closure*). In force with `mode = "loop-closure"`.
///
/// Submaps are rigid; frames are fused into one of them, the primary. Others are active as long as the camera is tracked in them
/// too, which measures where they lie.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SubmapSettings {
    /// A submap's central part: so many of the blocks that its first frame saw.
    pub central_blocks: u32,
    /// A new submap begins, or another active one becomes the primary, where less than this share of the primary's central
    /// part is in view.
    pub new_below: f64,
    /// Submaps that are tracked at once at most, the primary included, at least 2.
    pub max_active: u32,
    /// An active submap becomes passive once tracking in it has failed for so many frames in a row.
    pub passive_after: u32,
    /// Frames that must be good in two submaps before the pose between those is taken for measured.
    pub link_frames: u32,
    /// Of those, differences from the pose between the submaps count fully up to this: metres, and radians at a metre's
    /// distance (Huber's kernel).
    pub link_huber: f64,
    /// Share of them that must agree with that pose so far.
    pub link_inliers: f64,
    /// A view is compared with keyframes of passive submaps every so many frames.
    pub look_every: u32,
    /// A keyframe is a candidate for a closure where the view's dissimilarity from it is at most this, 0 to 1.
    pub max_dissimilarity: f64,
    /// A candidate is tracked for so many frames,
    pub closure_tries: u32,
    /// of which so many must be good before the closure is accepted.
    pub closure_successes: u32,
    /// A closure that moves the camera by more than this share of the way since its submap was left, and `max_drift_m` on top,
    /// is refused: places that look alike lie further apart than tracking drifts.
    pub max_drift: f64,
    /// In metres.
    pub max_drift_m: f64,
    /// The poses of all submaps are optimised after each closure, and after so many other measurements between submaps.
    pub optimise_every: u32,
    /// So many frames later the result is taken over, whenever it is there, so that runs repeat.
    pub optimise_delay: u32,
}

impl Default for SubmapSettings {
    fn default() -> Self {
        Self {
            central_blocks: 1000,
            new_below: 0.2,
            max_active: 3,
            passive_after: 10,
            link_frames: 10,
            link_huber: 0.1,
            link_inliers: 0.8,
            look_every: 5,
            max_dissimilarity: 0.35,
            closure_tries: 20,
            closure_successes: 10,
            max_drift: 0.05,
            max_drift_m: 0.2,
            optimise_every: 1,
            optimise_delay: 10,
        }
    }
}

impl SubmapSettings {
    /// Checks every value's range.
    ///
    /// # Errors
    /// The first value out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        for (key, value, least) in [
            ("submaps.central_blocks", self.central_blocks, 1),
            ("submaps.max_active", self.max_active, 2),
            ("submaps.passive_after", self.passive_after, 1),
            ("submaps.link_frames", self.link_frames, 1),
            ("submaps.look_every", self.look_every, 1),
            ("submaps.closure_tries", self.closure_tries, 1),
            ("submaps.closure_successes", self.closure_successes, 1),
            ("submaps.optimise_every", self.optimise_every, 1),
            ("submaps.optimise_delay", self.optimise_delay, 1),
        ] {
            check(
                (least..=1_000_000).contains(&value),
                key,
                "a whole number from 1 (max_active: 2) to a million",
                value,
            )?;
        }
        check(self.max_active <= 64, "submaps.max_active", "at most 64", self.max_active)?;
        let enough = self.closure_successes <= self.closure_tries;
        check(enough, "submaps.closure_successes", "at most submaps.closure_tries", self.closure_successes)?;
        for (key, share) in [
            ("submaps.new_below", self.new_below),
            ("submaps.link_inliers", self.link_inliers),
            ("submaps.max_dissimilarity", self.max_dissimilarity),
        ] {
            check((0.0..=1.0).contains(&share), key, "between 0 and 1", share)?;
        }
        for (key, value) in [
            ("submaps.link_huber", self.link_huber),
            ("submaps.max_drift", self.max_drift),
            ("submaps.max_drift_m", self.max_drift_m),
        ] {
            check((0.0..=1000.0).contains(&value), key, "between 0 and 1000", value)?;
        }
        check(self.link_huber > 0.0, "submaps.link_huber", "above 0", self.link_huber)
    }
}
