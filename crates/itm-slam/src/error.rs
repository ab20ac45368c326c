//! What can go wrong in a run.

use thiserror::Error;

/// What can go wrong in a run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// On the device.
    #[error(transparent)]
    Gpu(#[from] itm_gpu::Error),
    /// In a recording.
    #[error(transparent)]
    Io(#[from] itm_io::Error),
    /// Among the keyframes.
    #[error(transparent)]
    Relocaliser(#[from] itm_reloc::Error),
    /// In the settings.
    #[error(transparent)]
    Settings(#[from] itm_core::SettingsError),
    /// In the calibration.
    #[error(transparent)]
    Calibration(#[from] itm_core::CalibrationError),
    /// A map file that holds no session, or one that this version cannot go on from.
    #[error("cannot go on from '{}': {reason}", path.display())]
    SavedState {
        /// The file.
        path: std::path::PathBuf,
        /// Why not.
        reason: String,
    },
    /// A map that is not of the kind that the settings ask for.
    #[error("the map '{}' has {what} {map}, but the settings say {settings}", path.display())]
    OtherMap {
        /// The file.
        path: std::path::PathBuf,
        /// What differs.
        what: &'static str,
        /// What the map has.
        map: String,
        /// What the settings say.
        settings: String,
    },
    /// A map in which the camera is to be found, and that has nothing to find it by.
    #[error(
        "nothing says where in the map '{}' the camera is: it has no keyframes, or relocaliser.kind is off; give the \
         first frame's pose (--start-pose)",
        path.display()
    )]
    NoKeyframes {
        /// The file.
        path: std::path::PathBuf,
    },
    /// A map in which the camera is to be found, but not by the keyframes that it has.
    #[error(
        "nothing says where in the map '{}' the camera is: {reason}; with its own settings its keyframes do, and with the \
         first frame's pose (--start-pose) the session starts without them",
        path.display()
    )]
    UnusableKeyframes {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with them.
        reason: itm_reloc::Error,
    },
    /// A map to start in that holds nothing.
    #[error("the map '{}' is empty: it holds no blocks", path.display())]
    EmptyMap {
        /// The file.
        path: std::path::PathBuf,
    },
    /// Blocks of a submap whose place in the world is not known.
    #[error("there are blocks of submap {submap}, but no pose says where it lies in the world")]
    NoSubmapPose {
        /// Its number.
        submap: u16,
    },
    /// Two poses of one submap.
    #[error("submap {submap} has two poses in the world, where one is needed")]
    TwoSubmapPoses {
        /// Its number.
        submap: u16,
    },
    /// A pose of a submap that is none.
    #[error("the pose of submap {submap} in the world is none: {reason}")]
    SubmapPose {
        /// Its number.
        submap: u16,
        /// What is wrong with it.
        reason: itm_core::PoseError,
    },
    /// A submap that its pose puts where no block has a number.
    #[error(
        "submap {submap} lies further from the world's origin than blocks can be numbered: 16 bits along each axis"
    )]
    SubmapOutOfReach {
        /// Its number.
        submap: u16,
    },
    /// A frame's pose was to be found in a session whose poses are given, which prepares nothing for that.
    #[error("a session with given poses does not track: it cannot find a frame's pose")]
    PosesAreGiven,
    /// Nothing is to be fused, and there is no map to track against.
    #[error("map.fuse is off, so that nothing can be mapped, but there is no map to start in (--map)")]
    NothingToTrackAgainst,
    /// What changed was asked for, and nobody kept it.
    #[error("what changed since a frame is known only where map.track_changes is on")]
    ChangesNotTracked,
    /// What a map of surfels does not have was asked for.
    #[error("a map of surfels has no {what}: that takes one of voxels (mode 'basic' or 'loop-closure')")]
    NeedsVoxels {
        /// What was asked for.
        what: &'static str,
    },
    /// Given poses were asked for, and the recording has none.
    #[error("the recording '{recording}' has no poses, so it cannot be fused with given ones")]
    NoPoses {
        /// Its name.
        recording: String,
    },
    /// A tracker that compares colours, where there are none.
    #[error("the tracker '{tracker}' compares colours, but {reason}")]
    NoColour {
        /// The tracker's name in settings.
        tracker: &'static str,
        /// Why there are none, and what would do.
        reason: String,
    },
    /// A tracker that uses an inertial sensor's readings, where there are none.
    #[error(
        "the tracker '{tracker}' turns the camera as an inertial sensor says, but the recording '{recording}' has neither a \
         gyroscope's readings nor a sensor's orientations; without them '{instead}' does the same"
    )]
    NoInertialSensor {
        /// The tracker's name in settings.
        tracker: &'static str,
        /// The recording's name.
        recording: String,
        /// The tracker that needs no sensor.
        instead: &'static str,
    },
    /// A tracker that takes poses from files, of which one is missing.
    #[error("the tracker 'file' takes poses from '{mask}', which has none of frame {frame}")]
    NoPoseOfFrame {
        /// Mask of the files, or the trajectory's name.
        mask: String,
        /// First frame of those asked for that has no pose.
        frame: usize,
    },
    /// A range of frames that the recording does not have.
    #[error("frames {first} to {last} were asked for, but the recording '{recording}' has {frames}")]
    NoSuchFrames {
        /// Its name.
        recording: String,
        /// First frame asked for.
        first: usize,
        /// Last frame asked for.
        last: usize,
        /// Number of frames there are.
        frames: usize,
    },
}
