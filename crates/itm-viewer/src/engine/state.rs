//! What the window knows of the reconstruction.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use itm_slam::{Canvas, ColourImage, FrameResult, FrameStatus, Intrinsics, Se3, Settings, SubmapState};

/// Messages that are kept.
const MESSAGES: usize = 500;

/// What the window knows of the reconstruction. The engine changes it as it goes, the window reads it as it draws.
#[derive(Clone, Default)]
pub(crate) struct State {
    pub(crate) scene: Scene,
    /// How often something was opened, and where the last lies.
    pub(crate) opened: (u64, PathBuf),
    /// Whether frames are being processed, one after the other.
    pub(crate) running: bool,
    /// Whether frames are fused into the map.
    pub(crate) fusing: bool,
    /// The settings in force, and as they were asked for: those in force leave out what the recording cannot fill.
    pub(crate) settings: Settings,
    pub(crate) asked: Settings,
    /// The last frame, where there was one.
    pub(crate) frame: Option<FrameSummary>,
    /// Depth on a scale of colours, and colour, of that frame or the one that is being sought.
    pub(crate) depth: Option<Arc<ColourImage>>,
    pub(crate) colour: Option<Arc<ColourImage>>,
    /// What was measured of each frame.
    pub(crate) rows: Vec<Row>,
    /// Where the camera was (world frame), frame by frame.
    pub(crate) trajectory: Arc<Vec<DVec3>>,
    pub(crate) keyframes: Arc<Vec<Se3>>,
    pub(crate) submaps: Vec<SubmapSummary>,
    /// Pairs of submaps between which a pose was measured, and whether the camera came back for it.
    pub(crate) links: Vec<(u16, u16, bool)>,
    /// The box around what was seen (world frame), for a view of it all.
    pub(crate) bounds: Option<(DVec3, DVec3)>,
    /// What takes time beside frames, and how much of it is done.
    pub(crate) busy: Option<Busy>,
    pub(crate) shown: Option<Shown>,
    /// Whether no finer picture comes unless something changes.
    pub(crate) is_finest: bool,
    /// The point that was last asked for by a pixel, and how many were.
    pub(crate) picked: (u64, Option<DVec3>),
    /// What is being recorded: the file or folder, and the pictures so far.
    pub(crate) recording: Option<(PathBuf, u64)>,
    pub(crate) messages: VecDeque<Message>,
    /// How many messages there were, those included that are not kept.
    pub(crate) told: u64,
}

/// What is open.
#[derive(Clone, Debug, Default)]
pub(crate) enum Scene {
    #[default]
    Nothing,
    /// A recording that is reconstructed.
    Recording {
        name: String,
        /// What is known of it, in words.
        about: String,
        depth_camera: Intrinsics,
        /// The frames that are run over, and the one that comes next.
        frames: Range<usize>,
        next: usize,
        /// Whether no more frames come.
        finished: bool,
    },
    /// A saved map.
    Map { name: String, about: String, depth_camera: Intrinsics },
    /// What a run wrote.
    Results { name: String, about: String },
}

impl Scene {
    pub(crate) fn name(&self) -> Option<&str> {
        match self {
            Self::Nothing => None,
            Self::Recording { name, .. } | Self::Map { name, .. } | Self::Results { name, .. } => Some(name),
        }
    }

    pub(crate) fn about(&self) -> &str {
        match self {
            Self::Nothing => "",
            Self::Recording { about, .. } | Self::Map { about, .. } | Self::Results { about, .. } => about,
        }
    }

    /// The camera of a recording, or of the one that a map was made from.
    pub(crate) fn depth_camera(&self) -> Option<Intrinsics> {
        match self {
            Self::Recording { depth_camera, .. } | Self::Map { depth_camera, .. } => Some(*depth_camera),
            _ => None,
        }
    }

    /// Whether frames can be processed.
    pub(crate) fn has_frames(&self) -> bool {
        matches!(self, Self::Recording { .. })
    }

    /// Whether there is a map to save and to mesh.
    pub(crate) fn has_map(&self) -> bool {
        matches!(self, Self::Recording { .. } | Self::Map { .. })
    }
}

/// What became of a frame.
#[derive(Clone, Debug)]
pub(crate) struct FrameSummary {
    pub(crate) index: u64,
    pub(crate) verdict: Verdict,
    pub(crate) reasons: Vec<String>,
    pub(crate) world_from_camera: Option<Se3>,
}

/// What became of a frame, as a colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Good,
    Poor,
    Lost,
    /// There was nothing to judge by.
    Unjudged,
}

impl Verdict {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor => "poor",
            Self::Lost => "lost",
            Self::Unjudged => "not tracked",
        }
    }
}

impl FrameSummary {
    pub(crate) fn of(result: &FrameResult) -> Self {
        let told = || result.tracked.iter().flat_map(|tracked| tracked.reasons.iter().cloned()).collect::<Vec<_>>();
        let (verdict, reasons) = match &result.status {
            FrameStatus::Placed | FrameStatus::Tracked => (Verdict::Good, Vec::new()),
            FrameStatus::Poor { reason } => (Verdict::Poor, or_else(told(), reason)),
            FrameStatus::Lost { reason } => (Verdict::Lost, or_else(told(), reason)),
            FrameStatus::NoPose => (Verdict::Unjudged, vec!["there is no given pose".into()]),
            FrameStatus::NoDepth => (Verdict::Unjudged, vec!["no pixel has a depth within the view's range".into()]),
        };
        Self { index: result.index, verdict, reasons, world_from_camera: result.world_from_camera }
    }
}

fn or_else(reasons: Vec<String>, reason: &str) -> Vec<String> {
    if reasons.is_empty() { vec![reason.to_owned()] } else { reasons }
}

/// What was measured of a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Row {
    pub(crate) frame: u64,
    pub(crate) total_ms: Option<f64>,
    pub(crate) stages_ms: Vec<(Cow<'static, str>, f64)>,
    /// Blocks, or surfels, in use.
    pub(crate) size: Option<u32>,
    /// Device memory of the map.
    pub(crate) map_mib: Option<f64>,
    /// Root mean square of the residuals of tracking.
    pub(crate) residual_mm: Option<f64>,
    pub(crate) verdict: Option<Verdict>,
}

/// Where a submap is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SubmapSummary {
    pub(crate) world_from_submap: Se3,
    pub(crate) state: SubmapState,
}

/// What takes time beside frames.
#[derive(Clone, Debug)]
pub(crate) struct Busy {
    pub(crate) what: String,
    /// From 0 to 1, where that is known.
    pub(crate) done: Option<f32>,
}

/// The picture that is shown.
#[derive(Clone, Debug)]
pub(crate) struct Shown {
    pub(crate) canvas: Arc<Canvas>,
    /// The camera that it is of, whose pixels are the canvas's, and its pose.
    pub(crate) camera: Intrinsics,
    pub(crate) world_from_camera: Se3,
    /// Whether it follows the recording's camera.
    pub(crate) follows: bool,
}

/// Something that a user should know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    /// The frame that it was with, where there was one.
    pub(crate) frame: Option<u64>,
    pub(crate) text: String,
    pub(crate) kind: Kind,
}

/// How much a message matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// For the list of what happened.
    Event,
    /// What was asked for was done.
    Done,
    /// Something was left out.
    Warning,
    /// What was asked for was not done.
    Error,
}

impl State {
    pub(crate) fn say(&mut self, frame: Option<u64>, kind: Kind, text: impl Into<String>) {
        self.messages.push_back(Message { frame, text: text.into(), kind });
        self.told += 1;
        if self.messages.len() > MESSAGES {
            self.messages.pop_front();
        }
    }

    /// Takes a point into the box around what was seen.
    pub(crate) fn reach(&mut self, point: DVec3) {
        self.bounds = Some(match self.bounds {
            Some((min, max)) => (min.min(point), max.max(point)),
            None => (point, point),
        });
    }
}
