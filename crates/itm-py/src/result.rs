//! What became of frames.

use itm_slam::tracking::Verdict;
use itm_slam::{FrameStatus, Optimised};
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;

/// What became of a frame.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct FrameResult {
    result: itm_slam::FrameResult,
    total_ms: f64,
}

impl FrameResult {
    pub(crate) fn new(result: itm_slam::FrameResult, total_ms: f64) -> Self {
        Self { result, total_ms }
    }
}

#[pymethods]
impl FrameResult {
    /// The frame's number.
    #[getter]
    fn index(&self) -> u64 {
        self.result.index
    }

    /// The frame's time in nanoseconds.
    #[getter]
    fn timestamp(&self) -> i64 {
        self.result.timestamp.0
    }

    /// The depth camera's pose, world_from_camera, 4x4 float64, metres; None where it has none.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.result.world_from_camera.map(|pose| arrays::matrix(py, &pose)).transpose()
    }

    /// 'placed' (the first frame, or one at its given pose), 'tracked', 'poor' (its pose may be off), 'lost', 'no-pose' or
    /// 'no-depth'.
    #[getter]
    fn status(&self) -> &'static str {
        match self.result.status {
            FrameStatus::Placed => "placed",
            FrameStatus::Tracked => "tracked",
            FrameStatus::Poor { .. } => "poor",
            FrameStatus::Lost { .. } => "lost",
            FrameStatus::NoPose => "no-pose",
            FrameStatus::NoDepth => "no-depth",
        }
    }

    /// Whether the pose can be relied on.
    #[getter]
    fn good(&self) -> bool {
        matches!(self.result.status, FrameStatus::Placed | FrameStatus::Tracked)
    }

    /// Why the frame is not good, in words and numbers; empty for one that is.
    #[getter]
    fn reasons(&self) -> Vec<String> {
        match (&self.result.status, &self.result.tracked) {
            (FrameStatus::Poor { .. } | FrameStatus::Lost { .. }, Some(tracked)) if !tracked.reasons.is_empty() => {
                tracked.reasons.clone()
            }
            (FrameStatus::Poor { reason } | FrameStatus::Lost { reason }, _) => vec![reason.clone()],
            (FrameStatus::NoPose, _) => vec!["poses are given, and this frame has none".into()],
            (FrameStatus::NoDepth, _) => vec!["there is no map yet, and this frame has no depth".into()],
            (FrameStatus::Placed | FrameStatus::Tracked, _) => Vec::new(),
        }
    }

    /// What tracking said of the pose: 'good', 'poor' or 'lost'; None where it was not tried.
    #[getter]
    fn verdict(&self) -> Option<&'static str> {
        self.result.tracked.as_ref().map(|tracked| match tracked.verdict {
            Verdict::Good => "good",
            Verdict::Poor => "poor",
            Verdict::Lost => "lost",
        })
    }

    /// The estimated chance that the pose is wrong by more than 5 cm or 5 degrees; None where tracking was not tried.
    #[getter]
    fn chance_wrong(&self) -> Option<f64> {
        self.result.tracked.as_ref().map(|tracked| tracked.chance_wrong)
    }

    /// Pixels that agree with the map, as a share of those with depth; None where tracking was not tried.
    #[getter]
    fn inlier_share(&self) -> Option<f64> {
        self.result.tracked.as_ref().map(|tracked| tracked.inlier_share)
    }

    /// Root mean square distance of these from the map, in metres; None where tracking was not tried.
    #[getter]
    fn rms_m(&self) -> Option<f64> {
        self.result.tracked.as_ref().map(|tracked| tracked.rms_m)
    }

    /// Covariance of the pose's error in the camera's axes, 6x6 float64, metres and then radians, of the sensor's noise alone;
    /// None where tracking was not tried.
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let Some(tracked) = &self.result.tracked else { return Ok(None) };
        let row = |i: usize| std::array::from_fn::<f64, 6, _>(|j| tracked.covariance[(i, j)]);
        arrays::rows(py, (0..6).map(row)).map(Some)
    }

    /// Whether the frame was fused into the map.
    #[getter]
    fn fused(&self) -> bool {
        self.result.fused
    }

    /// The submap that frames are fused into.
    #[getter]
    fn submap(&self) -> u16 {
        self.result.submap
    }

    /// Milliseconds that tracking took.
    #[getter]
    fn track_ms(&self) -> f64 {
        self.result.track_ms
    }

    /// Milliseconds that the frame took in all, on the host.
    #[getter]
    fn total_ms(&self) -> f64 {
        self.total_ms
    }

    /// What happened to the map beside the frame's fusion, in order.
    #[getter]
    fn happenings(&self) -> Vec<Happening> {
        self.result.happenings.iter().cloned().map(Happening).collect()
    }

    /// What has become known of an earlier frame, two frames before; None for the first ones.
    #[getter]
    fn report(&self) -> Option<FrameReport> {
        self.result.report.clone().map(FrameReport)
    }

    fn __repr__(&self) -> String {
        let fused = if self.result.fused { ", fused" } else { "" };
        format!("<FrameResult {}: {}{fused}, {:.1} ms>", self.result.index, self.status(), self.total_ms)
    }
}

/// What became known of a frame two frames later.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct FrameReport(pub(crate) itm_slam::FrameReport);

#[pymethods]
impl FrameReport {
    /// The frame's number.
    #[getter]
    fn index(&self) -> u64 {
        self.0.index
    }

    /// Blocks of voxels on the device, right after the frame.
    #[getter]
    fn blocks(&self) -> u32 {
        self.0.record.blocks.saturating_sub(self.0.record.free_blocks)
    }

    /// Surfels right after the frame; None in a map of voxels.
    #[getter]
    fn surfels(&self) -> Option<u32> {
        self.0.surfels.map(|record| record.used.saturating_sub(record.free))
    }

    /// Milliseconds on the device of each stage, in the order of the pipeline; empty where the device has no clock.
    #[getter]
    fn stage_ms<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        for (stage, ms) in &self.0.stage_ms {
            // A stage may run more than once in a frame.
            let before = dict.get_item(stage)?.map_or(Ok(0.0), |before| before.extract::<f64>())?;
            dict.set_item(stage, before + ms)?;
        }
        Ok(dict)
    }

    /// What a user should know of that frame, as that the map is full.
    #[getter]
    fn notices(&self) -> Vec<String> {
        self.0.notices.iter().map(ToString::to_string).collect()
    }

    fn __repr__(&self) -> String {
        match self.surfels() {
            Some(surfels) => format!("<FrameReport of frame {}: {surfels} surfels>", self.0.index),
            None => format!("<FrameReport of frame {}: {} blocks>", self.0.index, self.blocks()),
        }
    }
}

/// Something that happened to the map with a frame; as a string, in words.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Happening(pub(crate) itm_slam::Happening);

#[pymethods]
impl Happening {
    /// 'keyframe', 'relocalised', 'submap' (one begins), 'primary', 'passive', 'linked', 'closure-tried', 'closure-accepted',
    /// 'closure-refused' or 'optimised'.
    #[getter]
    fn kind(&self) -> &'static str {
        use itm_slam::Happening as H;
        match self.0 {
            H::Keyframe { .. } => "keyframe",
            H::Relocalised { .. } => "relocalised",
            H::Submap { .. } => "submap",
            H::Primary { .. } => "primary",
            H::Passive { .. } => "passive",
            H::Linked { .. } => "linked",
            H::ClosureTried { .. } => "closure-tried",
            H::ClosureAccepted { .. } => "closure-accepted",
            H::ClosureRefused { .. } => "closure-refused",
            H::Optimised(_) => "optimised",
            _ => "other",
        }
    }

    /// Numbers and names by the kind, as submap, from, to, keyframe, moved_m, reason.
    #[getter]
    fn details<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        use itm_slam::Happening as H;
        let dict = PyDict::new(py);
        match &self.0 {
            H::Keyframe { id, submap } => {
                dict.set_item("keyframe", id)?;
                dict.set_item("submap", submap)?;
            }
            H::Relocalised { keyframe, submap, dissimilarity } => {
                dict.set_item("keyframe", keyframe)?;
                dict.set_item("submap", submap)?;
                dict.set_item("dissimilarity", dissimilarity)?;
            }
            H::Submap { submap, from } | H::Primary { submap, from } => {
                dict.set_item("submap", submap)?;
                dict.set_item("from", from)?;
            }
            H::Passive { submap } => dict.set_item("submap", submap)?,
            H::Linked { from, to } => {
                dict.set_item("from", from)?;
                dict.set_item("to", to)?;
            }
            H::ClosureTried { submap, keyframe } => {
                dict.set_item("submap", submap)?;
                dict.set_item("keyframe", keyframe)?;
            }
            H::ClosureAccepted { from, to, moved_m } => {
                dict.set_item("from", from)?;
                dict.set_item("to", to)?;
                dict.set_item("moved_m", moved_m)?;
            }
            H::ClosureRefused { submap, reason } => {
                dict.set_item("submap", submap)?;
                dict.set_item("reason", reason)?;
            }
            H::Optimised(Optimised { submaps, links, moved_m, cost, doubted }) => {
                dict.set_item("submaps", submaps)?;
                dict.set_item("links", links)?;
                dict.set_item("moved_m", moved_m)?;
                dict.set_item("cost", (cost[0], cost[1]))?;
                dict.set_item("doubted", doubted)?;
            }
            _ => {}
        }
        Ok(dict)
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        format!("<Happening {}: {}>", self.kind(), self.0)
    }
}
