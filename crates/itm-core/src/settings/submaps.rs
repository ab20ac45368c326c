//! Maps of many submaps.

use serde::{Deserialize, Serialize};

use super::{SettingsError, check};

/// How the map is divided into submaps, and how their poses relative to each other are found (Kähler et al. 2016, *Real-Time
/// Large-Scale Dense 3D Reconstruction with Loop Closure*). In force with `mode = "loop-closure"`.
///
/// Submaps are rigid; frames are fused into one of them, the primary. Others are active as long as the camera is tracked in them
/// too, which measures where they lie.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SubmapSettings {
    /// A submap's central part: so many of the blocks that its first frame saw.
    pub central_blocks: u32,
    /// A new submap begins, or another active one becomes the primary, where less than this share of the primary's central
    /// part is in view.
    pub new_below: f64,
    /// Submaps that are tracked at once at most, the primary included, at least 2.
    pub max_active: u32,
    /// Beside the primary, tracking in a submap counts as good where at least this share of the frame's depth pixels agrees with it,
    /// 0 to 1: at the edge of the view, little is left to hold on to.
    pub min_inlier_share: f64,
    /// An active submap becomes passive once tracking in it has failed for so many frames in a row.
    pub passive_after: u32,
    /// Frames that must be good in two submaps before the pose between those is taken for measured.
    pub link_frames: u32,
    /// Of those, differences from the pose between the submaps count fully up to this: metres, and radians at a metre's
    /// distance (Huber's kernel).
    pub link_huber: f64,
    /// Share of them that must agree with that pose so far.
    pub link_inliers: f64,
    /// Of the frames that measure a pose between submaps, so many of the last ones count.
    pub link_window: u32,
    /// Standard deviation in metres that a frame's measurement of such a pose has at least, at the camera: what a submap's own
    /// bend and its voxels leave, which no frame's equations know of.
    pub link_deviation_m: f64,
    /// The same, in radians.
    pub link_deviation_rad: f64,
    /// Whether passive submaps are looked for. Without, only submaps that are active at the same time are linked.
    pub close_loops: bool,
    /// A view is compared with keyframes of passive submaps every so many frames.
    pub look_every: u32,
    /// A keyframe is a candidate for a closure where the view's dissimilarity from it is at most this, 0 to 1.
    pub max_dissimilarity: f64,
    /// After a look that was worth a try, so many are left out.
    pub look_rest: u32,
    /// So many keyframes are looked at, the most similar ones, of those
    pub look_candidates: u32,
    /// that are within this many metres of the camera, and what `max_drift` allows on top,
    pub look_within_m: f64,
    /// and look in its direction but for this angle in radians.
    pub look_within_rad: f64,
    /// As long as `max_drift` allows no more than this many metres, the passive submap that shows most of its central part where
    /// the camera should be is looked at without a keyframe that resembles the view.
    pub expected_within_m: f64,
    /// At least this share of its central part, and `new_below`.
    pub expected_share: f64,
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
            min_inlier_share: 0.25,
            passive_after: 10,
            link_frames: 10,
            link_huber: 0.1,
            link_inliers: 0.8,
            link_window: 200,
            link_deviation_m: 2e-3,
            link_deviation_rad: 1e-3,
            close_loops: true,
            look_every: 5,
            max_dissimilarity: 0.35,
            look_rest: 2,
            look_candidates: 2,
            look_within_m: 1.0,
            look_within_rad: 0.7,
            expected_within_m: 2.0,
            expected_share: 0.3,
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
            ("submaps.link_window", self.link_window, 1),
            ("submaps.look_every", self.look_every, 1),
            ("submaps.look_rest", self.look_rest, 0),
            ("submaps.look_candidates", self.look_candidates, 1),
            ("submaps.closure_tries", self.closure_tries, 1),
            ("submaps.closure_successes", self.closure_successes, 1),
            ("submaps.optimise_every", self.optimise_every, 1),
            ("submaps.optimise_delay", self.optimise_delay, 1),
        ] {
            check(
                (least..=1_000_000).contains(&value),
                key,
                "a whole number from 1 (max_active: 2, look_rest: 0) to a million",
                value,
            )?;
        }
        check(self.max_active <= 64, "submaps.max_active", "at most 64", self.max_active)?;
        let enough = self.closure_successes <= self.closure_tries;
        check(enough, "submaps.closure_successes", "at most submaps.closure_tries", self.closure_successes)?;
        let enough = self.link_frames <= self.link_window;
        check(enough, "submaps.link_frames", "at most submaps.link_window", self.link_frames)?;
        for (key, share) in [
            ("submaps.new_below", self.new_below),
            ("submaps.min_inlier_share", self.min_inlier_share),
            ("submaps.link_inliers", self.link_inliers),
            ("submaps.expected_share", self.expected_share),
            ("submaps.max_dissimilarity", self.max_dissimilarity),
        ] {
            check((0.0..=1.0).contains(&share), key, "between 0 and 1", share)?;
        }
        for (key, value) in [
            ("submaps.link_huber", self.link_huber),
            ("submaps.link_deviation_m", self.link_deviation_m),
            ("submaps.link_deviation_rad", self.link_deviation_rad),
            ("submaps.look_within_m", self.look_within_m),
            ("submaps.look_within_rad", self.look_within_rad),
            ("submaps.expected_within_m", self.expected_within_m),
            ("submaps.max_drift", self.max_drift),
            ("submaps.max_drift_m", self.max_drift_m),
        ] {
            check((0.0..=1000.0).contains(&value), key, "between 0 and 1000", value)?;
        }
        for (key, value) in [
            ("submaps.link_huber", self.link_huber),
            ("submaps.link_deviation_m", self.link_deviation_m),
            ("submaps.link_deviation_rad", self.link_deviation_rad),
        ] {
            check(value > 0.0, key, "above 0", value)?;
        }
        Ok(())
    }
}
