//! How the camera is tracked.

use serde::{Deserialize, Serialize};

use super::{SettingsError, check, in_range};

/// How the camera is tracked, and what happens where that fails.
///
/// In a settings file and in overrides the whole tree may also be one string in the manner of the reference system,
/// `tracker = "type=extended,levels=rrbb,useDepth=1"`; see [`TrackerSettings::set_string`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct TrackerSettings {
    /// Which tracker.
    pub kind: TrackerKind,
    /// Whether a pose predicted at constant velocity is tried beside the last pose, and the better one kept.
    pub predict_motion: bool,
    /// Whether motion is held at the prediction, rather than estimated, in directions that the frame hardly determines.
    pub hold_degenerate: bool,
    /// A direction is hardly determined where moving along it by a metre (or a radian) changes the points' distances from
    /// their planes by less than the square root of this, in the root mean square: 0 for a slide along a wall, 1 for a
    /// motion straight at one.
    pub min_information: f64,
    /// What happens to a frame whose tracking failed.
    pub on_failure: OnFailure,
    /// Point-to-plane ICP on depth.
    pub icp: IcpSettings,
    /// Robust alignment of depth and colour together.
    pub extended: ExtendedSettings,
    /// Alignment of colour alone.
    pub rgb: RgbSettings,
    /// What an inertial sensor's readings mean.
    pub imu: ImuSettings,
    /// Poses from files.
    pub file: FileSettings,
    /// Several trackers together.
    pub composite: CompositeSettings,
    /// Whether the map is cast anew for each frame.
    pub forward_projection: ForwardProjectionSettings,
    /// When a frame counts as tracked.
    pub verdict: VerdictSettings,
}

impl Default for TrackerSettings {
    fn default() -> Self {
        Self {
            kind: TrackerKind::Extended,
            predict_motion: true,
            hold_degenerate: true,
            min_information: 1e-3,
            on_failure: OnFailure::default(),
            icp: IcpSettings::default(),
            extended: ExtendedSettings::default(),
            rgb: RgbSettings::default(),
            imu: ImuSettings::default(),
            file: FileSettings::default(),
            composite: CompositeSettings::default(),
            forward_projection: ForwardProjectionSettings::default(),
            verdict: VerdictSettings::default(),
        }
    }
}

/// The surface that the next frame is tracked against, approximated: the points of the frame before are projected forward, and
/// rays are cast only where none of them falls (the report, section 3.4 and its settings). Faster than a full raycast, but
/// points lag behind the map by as many frames as none is made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ForwardProjectionSettings {
    /// Whether to do so.
    pub enabled: bool,
    /// After so many frames in a row there is a full raycast.
    pub max_frames: u32,
    /// So there is where the camera has moved further than this since the last one, in metres: the report's 0.0005 m², squared.
    pub max_move_m: f64,
}

impl Default for ForwardProjectionSettings {
    fn default() -> Self {
        Self { enabled: false, max_frames: 5, max_move_m: 0.02236 }
    }
}

/// A kind of tracker.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum TrackerKind {
    /// Point-to-plane ICP on depth; `tracker.icp`.
    Icp,
    /// Robust alignment of depth and colour together; `tracker.extended`.
    #[default]
    Extended,
    /// Colour of surface points against the live image; `tracker.rgb`.
    Rgb,
    /// Rotation from an inertial sensor, refined by `icp`; `tracker.imu`.
    ImuIcp,
    /// Rotation from an inertial sensor, refined by `extended`; `tracker.imu`.
    ExtendedImu,
    /// Poses from files; `tracker.file`.
    File,
    /// Always fails, for tests.
    ForceFail,
    /// Several trackers; `tracker.composite`.
    Composite,
}

impl TrackerKind {
    /// Every kind.
    pub const ALL: [Self; 8] = [
        Self::Icp,
        Self::Extended,
        Self::Rgb,
        Self::ImuIcp,
        Self::ExtendedImu,
        Self::File,
        Self::ForceFail,
        Self::Composite,
    ];

    /// Its name in settings.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Icp => "icp",
            Self::Extended => "extended",
            Self::Rgb => "rgb",
            Self::ImuIcp => "imuicp",
            Self::ExtendedImu => "extendedimu",
            Self::File => "file",
            Self::ForceFail => "forcefail",
            Self::Composite => "composite",
        }
    }
}

/// What happens to a frame whose tracking failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum OnFailure {
    /// The frame gets no pose and is not fused. The next ones are tracked from the last good pose and from poses around it,
    /// and are fused once `tracker.verdict.frames_to_recover` of them in a row were good.
    #[default]
    Relocalise,
    /// The frame gets no pose and is not fused; the next one is tracked from the last good pose.
    StopIntegrating,
    /// The last good pose is taken for the frame's, and it is fused there.
    Ignore,
}

/// How a measurement's weight follows its depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DepthWeight {
    /// All count alike.
    None,
    /// `(1 - (z - near) / (far - near))²` over the view's depth range (the report, section 3.1.3).
    Linear,
    /// The inverse of a Kinect's variance, relative to that at its best: with σ(z) = 0.0012 + 0.0019 (z - 0.4)² metres
    /// (Nguyen et al. 2012), `(σ(0.4) / σ(z))²`.
    Noise,
}

/// Point-to-plane ICP on a pyramid (Newcombe et al. 2011, *KinectFusion*, section 3.5; the report, section 3.1.1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct IcpSettings {
    /// One letter a pyramid level, from coarse to fine: `r` estimates rotation, `t` translation, `b` both, `n` nothing.
    pub levels: String,
    /// Largest number of steps at the coarsest level.
    pub max_steps_coarse: u32,
    /// Largest number of steps at the finest level; those between are interpolated.
    pub max_steps_fine: u32,
    /// Largest distance of corresponding points at the coarsest level, in metres.
    pub max_distance_coarse_m: f32,
    /// Largest distance of corresponding points at the finest level, in metres; those between are interpolated.
    pub max_distance_fine_m: f32,
    /// A level ends when a step moves less than this (metres and radians, as the norm of the twist).
    pub min_step: f64,
    /// Tracking has failed where the root mean square of the pairs' distances is larger than this many millimetres; 0
    /// leaves that to the verdict.
    pub max_rms_mm: f64,
}

impl Default for IcpSettings {
    fn default() -> Self {
        Self {
            levels: "rrrbb".into(),
            max_steps_coarse: 10,
            max_steps_fine: 4,
            max_distance_coarse_m: 0.1,
            max_distance_fine_m: 0.045,
            min_step: 1e-4,
            max_rms_mm: 0.0,
        }
    }
}

/// Robust alignment of depth, and colour, from coarse to fine by Levenberg-Marquardt steps (the report, section 3.1.3).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ExtendedSettings {
    /// One letter a pyramid level, from coarse to fine: `r` estimates rotation, `t` translation, `b` both, `n` nothing.
    pub levels: String,
    /// Whether depth is compared with the map.
    pub use_depth: bool,
    /// Whether colour is compared with the frame before, where both have it.
    pub use_colour: bool,
    /// Whether colour is compared with the map, where it has colour.
    pub use_map_colour: bool,
    /// How much the colour terms count beside depth, each being measured in its own standard deviations.
    pub colour_weight: f64,
    /// Where depth alone determines every direction of motion this well (in the measure of `tracker.min_information`), colour
    /// counts a sixteenth; where better, less still: `1 / (1 + (information / this)²)⁴`. 0 for colour that always counts alike.
    pub enough_information: f64,
    /// Whether a gain and an offset between the images compared are estimated with the pose, as a camera's automatic
    /// exposure changes them.
    pub estimate_exposure: bool,
    /// Finest level at which colour is compared; 0 is full resolution.
    pub finest_colour_level: u32,
    /// Largest number of steps at the coarsest level.
    pub max_steps_coarse: u32,
    /// Largest number of steps at the finest level; those between are interpolated.
    pub max_steps_fine: u32,
    /// A level ends when a step moves less than this (metres and radians, as the norm of the twist).
    pub min_step: f64,
    /// Largest distance of a point from its partner's plane at the coarsest level, in metres.
    pub max_plane_distance_coarse_m: f32,
    /// The same at the finest level; those between are interpolated geometrically.
    pub max_plane_distance_fine_m: f32,
    /// Distances beyond this share of the largest one count linearly instead of squared (Huber 1964).
    pub huber_share: f32,
    /// How a pixel's weight follows its depth.
    pub depth_weight: DepthWeight,
    /// Largest difference in intensity (0 to 1) at the coarsest level.
    pub max_colour_difference_coarse: f32,
    /// The same at the finest level; those between are interpolated geometrically.
    pub max_colour_difference_fine: f32,
    /// Differences in intensity of so many standard deviations no longer count (Tukey's biweight), where that is less than
    /// the largest difference.
    pub tukey_cutoff: f32,
    /// Pixels whose intensity changes by less than this from one to the next do not count.
    pub min_colour_gradient: f32,
    /// From this frame on, surface points that were observed only once are passed over.
    pub frames_to_skip: u32,
    /// From this frame on, surface points count by their confidence: fully once they were observed
    /// `full_confidence` times.
    pub frames_to_weight: u32,
    /// Observations after which a surface point counts fully.
    pub full_confidence: u32,
    /// Fewest pairs from which a pose is estimated.
    pub min_pairs: u32,
    /// Tracking has failed where the root mean square of the pairs' distances is larger than this many millimetres; 0
    /// leaves that to the verdict.
    pub max_rms_mm: f64,
}

impl Default for ExtendedSettings {
    fn default() -> Self {
        Self {
            levels: "rbbb".into(),
            use_depth: true,
            use_colour: true,
            use_map_colour: false,
            colour_weight: 6.0,
            enough_information: 0.004,
            estimate_exposure: true,
            finest_colour_level: 1,
            max_steps_coarse: 10,
            max_steps_fine: 4,
            min_step: 1e-4,
            max_plane_distance_coarse_m: 0.1,
            max_plane_distance_fine_m: 0.02,
            huber_share: 0.25,
            depth_weight: DepthWeight::Noise,
            max_colour_difference_coarse: 0.175,
            max_colour_difference_fine: 0.1,
            tukey_cutoff: 4.7,
            min_colour_gradient: 0.004,
            frames_to_skip: 20,
            frames_to_weight: 50,
            full_confidence: 10,
            min_pairs: 100,
            max_rms_mm: 0.0,
        }
    }
}

/// Alignment of surface points' colours with the live image by Levenberg-Marquardt steps (the report, section 3.1.2).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RgbSettings {
    /// One letter a pyramid level, from coarse to fine: `r` estimates rotation, `t` translation, `b` both, `n` nothing.
    pub levels: String,
    /// Whether only every other point along both axes is compared: less work, and less is known. Not as a part of a composite.
    pub skip_points: bool,
    /// Largest number of steps at a level.
    pub max_steps: u32,
    /// A level ends when a step moves less than this (metres and radians, as the norm of the twist).
    pub min_step: f64,
    /// A level ends when a step lowers the cost by a smaller share than this.
    pub min_decrease: f64,
    /// Differences in colour (0 to 1) as large as this no longer count (Tukey's biweight).
    pub max_difference: f32,
}

impl Default for RgbSettings {
    fn default() -> Self {
        Self {
            levels: "rrbb".into(),
            skip_points: false,
            max_steps: 100,
            min_step: 5e-5,
            min_decrease: 1e-5,
            max_difference: 0.3,
        }
    }
}

/// What an inertial sensor's readings mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ImuSettings {
    /// Levels of `imuicp`, as `tracker.icp.levels`.
    pub icp_levels: String,
    /// Levels of `extendedimu`, as `tracker.extended.levels`.
    pub extended_levels: String,
    /// Rotation from the sensor's axes to the depth camera's, as a quaternion x, y, z, w.
    pub camera_from_imu: [f64; 4],
    /// What the gyroscope reads at rest, in rad/s, in its own axes.
    pub gyroscope_bias: [f64; 3],
}

impl Default for ImuSettings {
    fn default() -> Self {
        Self {
            icp_levels: "tb".into(),
            extended_levels: "ttb".into(),
            camera_from_imu: [0.0, 0.0, 0.0, 1.0],
            gyroscope_bias: [0.0; 3],
        }
    }
}

/// Poses from files.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct FileSettings {
    /// A mask with the frame's number (`poses/%06d.txt`), each file a 4x4 matrix from camera to world, or a trajectory in
    /// TUM format. A session refuses to start where a frame has none; in frames from elsewhere, such a one counts as lost.
    pub mask: String,
}

/// Several trackers together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct CompositeSettings {
    /// How they work together.
    pub policy: CompositePolicy,
    /// Their strings, in order, as for [`TrackerSettings::set_string`]. None of them may be a composite itself.
    pub trackers: Vec<String>,
}

impl Default for CompositeSettings {
    fn default() -> Self {
        Self { policy: CompositePolicy::Refine, trackers: vec!["type=icp,levels=rrnn".into(), "type=extended".into()] }
    }
}

/// How several trackers work together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum CompositePolicy {
    /// Each starts where the one before ended; the last one's verdict counts.
    #[default]
    Refine,
    /// Each starts where the one before ended, as long as none was lost; the worst verdict counts.
    Sequential,
    /// Each starts from the prediction; the first one whose verdict is good counts, or else the best one.
    FirstSuccess,
}

/// When a frame counts as tracked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct VerdictSettings {
    /// Whether the classifier decides; without it every finite pose from enough pairs is good.
    pub classify: bool,
    /// A frame is good where the classifier's estimate of the chance that its pose is wrong is at most this; 0 for what was
    /// found in training.
    pub good_below: f64,
    /// A frame is lost where the estimate is more than this, and poor in between; 0 for what was found in training.
    pub lost_above: f64,
    /// Frames with a good verdict in a row after a loss, from which on frames are fused again.
    pub frames_to_recover: u32,
    /// Whether frames with a poor verdict are fused.
    pub fuse_poor: bool,
}

impl Default for VerdictSettings {
    fn default() -> Self {
        Self { classify: true, good_below: 0.0, lost_above: 0.0, frames_to_recover: 3, fuse_poor: false }
    }
}

impl TrackerSettings {
    /// Checks every value's range.
    ///
    /// # Errors
    /// The first value out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let Self { min_information, icp, extended, rgb, imu, forward_projection, verdict, .. } = self;
        let positive = |v: f64| v.is_finite() && v >= 0.0;
        check(positive(*min_information), "tracker.min_information", "zero or positive", min_information)?;
        for (key, levels) in [
            ("tracker.icp.levels", &icp.levels),
            ("tracker.extended.levels", &extended.levels),
            ("tracker.rgb.levels", &rgb.levels),
            ("tracker.imu.icp_levels", &imu.icp_levels),
            ("tracker.imu.extended_levels", &imu.extended_levels),
        ] {
            let known = levels.chars().all(|c| "rtbn".contains(c));
            check((1..=8).contains(&levels.len()) && known, key, "one to eight of the letters r, t, b, n", levels)?;
        }
        let a_distance = "between 0.0001 and 10";
        for (key, v) in [
            ("tracker.icp.max_distance_coarse_m", icp.max_distance_coarse_m),
            ("tracker.icp.max_distance_fine_m", icp.max_distance_fine_m),
            ("tracker.extended.max_plane_distance_coarse_m", extended.max_plane_distance_coarse_m),
            ("tracker.extended.max_plane_distance_fine_m", extended.max_plane_distance_fine_m),
        ] {
            check(in_range(v, 1e-4, 10.0), key, a_distance, v)?;
        }
        for (key, v) in [
            ("tracker.extended.max_colour_difference_coarse", extended.max_colour_difference_coarse),
            ("tracker.extended.max_colour_difference_fine", extended.max_colour_difference_fine),
            ("tracker.rgb.max_difference", rgb.max_difference),
        ] {
            check(in_range(v, 1e-4, 10.0), key, "between 0.0001 and 10", v)?;
        }
        for (key, v) in [
            ("tracker.icp.min_step", icp.min_step),
            ("tracker.icp.max_rms_mm", icp.max_rms_mm),
            ("tracker.extended.min_step", extended.min_step),
            ("tracker.extended.max_rms_mm", extended.max_rms_mm),
            ("tracker.extended.colour_weight", extended.colour_weight),
            ("tracker.extended.enough_information", extended.enough_information),
            ("tracker.extended.min_colour_gradient", extended.min_colour_gradient.into()),
            ("tracker.rgb.min_step", rgb.min_step),
            ("tracker.forward_projection.max_move_m", forward_projection.max_move_m),
            ("tracker.rgb.min_decrease", rgb.min_decrease),
        ] {
            check(positive(v), key, "zero or positive", v)?;
        }
        check(
            extended.use_depth || extended.use_colour || extended.use_map_colour,
            "tracker.extended.use_depth",
            "true where neither use_colour nor use_map_colour is",
            extended.use_depth,
        )?;
        check(
            in_range(extended.huber_share, 0.01, 1.0),
            "tracker.extended.huber_share",
            "between 0.01 and 1",
            extended.huber_share,
        )?;
        check(
            in_range(extended.tukey_cutoff, 0.1, 1e3),
            "tracker.extended.tukey_cutoff",
            "between 0.1 and 1000",
            extended.tukey_cutoff,
        )?;
        check(
            extended.finest_colour_level <= 7,
            "tracker.extended.finest_colour_level",
            "at most 7",
            extended.finest_colour_level,
        )?;
        check(
            extended.full_confidence >= 1,
            "tracker.extended.full_confidence",
            "at least 1",
            extended.full_confidence,
        )?;
        let length = imu.camera_from_imu.iter().map(|v| v * v).sum::<f64>().sqrt();
        check((length - 1.0).abs() < 0.01, "tracker.imu.camera_from_imu", "a quaternion of unit length", length)?;
        check(
            imu.gyroscope_bias.iter().all(|v| v.is_finite()),
            "tracker.imu.gyroscope_bias",
            "finite",
            format!("{:?}", imu.gyroscope_bias),
        )?;
        check(
            (0.0..=1.0).contains(&verdict.good_below),
            "tracker.verdict.good_below",
            "between 0 and 1",
            verdict.good_below,
        )?;
        check(
            (0.0..=1.0).contains(&verdict.lost_above)
                && (verdict.lost_above == 0.0 || verdict.lost_above >= verdict.good_below),
            "tracker.verdict.lost_above",
            "0, or between tracker.verdict.good_below and 1",
            verdict.lost_above,
        )?;
        if self.kind == TrackerKind::Composite {
            check(!self.composite.trackers.is_empty(), "tracker.composite.trackers", "at least one tracker", "none")?;
            self.parts()?;
        }
        Ok(())
    }
}
