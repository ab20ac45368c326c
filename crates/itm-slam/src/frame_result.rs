//! What became of a frame, and what a user should know of it.

use itm_core::{Se3, Timestamp};
use itm_gpu::{FrameRecord, SurfelRecord};

use crate::happening::Happening;
use crate::tracking::Tracked;

/// What became of a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameStatus {
    /// The map's first frame, or one fused at its given pose.
    Placed,
    /// Tracked, and its pose can be relied on.
    Tracked,
    /// Tracked, but its pose may be off, for this reason. Not fused unless `tracker.verdict.fuse_poor` says so.
    Poor {
        /// In words and numbers.
        reason: String,
    },
    /// Not tracked, for this reason.
    Lost {
        /// In words and numbers.
        reason: String,
    },
    /// Poses are given, but this frame has none (or one that is not finite).
    NoPose,
    /// There is no map yet, and this frame has no depth to begin one with.
    NoDepth,
}

/// Something that a user should know.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Notice {
    /// New blocks found no room, and wait for it.
    Waiting {
        /// How many.
        blocks: u32,
        /// Blocks that the map can hold on the device.
        capacity: u32,
        /// Device memory that would hold the waiting ones too, in MiB: see `map.device_budget_mib`.
        needed_mib: u64,
    },
    /// Blocks that left the device cannot be written to the host's file. They stay in memory, beyond its budget, and no
    /// more leave: from here on the map is as large as the device's budget.
    HostStore {
        /// Which file, and why not.
        reason: String,
    },
    /// New surfels found no room, for the map has reached its budget: parts of the scene are missing.
    SurfelsDropped {
        /// How many, in one frame.
        surfels: u32,
        /// Surfels that the map can hold.
        capacity: u32,
    },
    /// New blocks found no room, and none to wait in either: parts of the scene are missing.
    Dropped {
        /// How many, in one frame.
        blocks: u32,
    },
}

impl std::fmt::Display for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Waiting { blocks, capacity, needed_mib } => write!(
                f,
                "the map is full at {capacity} blocks, and none of them can leave: {blocks} new ones wait for room; a \
                 map.device_budget_mib of {needed_mib} would do"
            ),
            Self::HostStore { reason } => {
                write!(f, "no more blocks leave the device, because they cannot be stored: {reason}")
            }
            Self::SurfelsDropped { surfels, capacity } => write!(
                f,
                "the map is full at {capacity} surfels: {surfels} new ones were left out (surfels.device_budget_mib)"
            ),
            Self::Dropped { blocks } => {
                write!(f, "the map is full: {blocks} new blocks were dropped, with no room to wait in")
            }
        }
    }
}

/// What became known of a frame two frames later: the map's counters after it, and what its stages took.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameReport {
    /// The frame's index.
    pub index: u64,
    /// The map's counters right after it.
    pub record: FrameRecord,
    /// The surfels' counters right after it, where the map is one of surfels.
    pub surfels: Option<SurfelRecord>,
    /// Milliseconds on the device of each stage, in the order of the pipeline; empty where the device has no clock.
    pub stage_ms: Vec<(&'static str, f64)>,
    /// What a user should know of that frame.
    pub notices: Vec<Notice>,
}

/// What [`Slam::process`](crate::Slam::process) found.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameResult {
    /// The frame's index.
    pub index: u64,
    /// The frame's time.
    pub timestamp: Timestamp,
    /// The depth camera's pose, where there is one: with several submaps, as those lie now.
    pub world_from_camera: Option<Se3>,
    /// The submap that frames are fused into.
    pub submap: u16,
    /// What became of the frame.
    pub status: FrameStatus,
    /// What tracking found, in the frame of the submap that it was tracked in; `None` where it was not tried.
    pub tracked: Option<Tracked>,
    /// Whether the frame was fused into the map.
    pub fused: bool,
    /// Milliseconds that tracking took, waits included.
    pub track_ms: f64,
    /// What happened to the map beside the frame's fusion, in order.
    pub happenings: Vec<Happening>,
    /// What has become known of an earlier frame.
    pub report: Option<FrameReport>,
}
