//! A run in words and numbers.

use std::collections::BTreeMap;
use std::path::PathBuf;

use itm_core::evaluation::Evaluation;
use serde::Serialize;

use crate::mesh_error::MeshError;
use crate::timings::Row;

/// A run in words and numbers: what `--json` prints, and what the report is made from.
#[derive(Serialize)]
pub(crate) struct Summary {
    pub(crate) recording: String,
    pub(crate) format: String,
    pub(crate) calibration: String,
    /// Frames of the whole recording.
    pub(crate) recording_frames: usize,
    pub(crate) has_colour: bool,
    pub(crate) has_gyroscope: bool,
    pub(crate) device: String,
    /// `tracked` or `given`.
    pub(crate) poses: &'static str,
    /// Frames that were asked for.
    pub(crate) frames: usize,
    /// Frames that were reached before the end of the run.
    pub(crate) frames_reached: usize,
    pub(crate) posed: usize,
    /// Share of the frames reached that have a pose.
    pub(crate) posed_share: f64,
    pub(crate) poor: usize,
    pub(crate) lost: usize,
    pub(crate) skipped: usize,
    pub(crate) stopped: bool,
    /// What ended the run early, or could not be written.
    pub(crate) errors: Vec<String>,
    pub(crate) seconds: f64,
    pub(crate) frames_per_second: f64,
    pub(crate) median_frame_ms: Option<f64>,
    /// By stage, of the frames that went through it.
    pub(crate) median_stage_ms: BTreeMap<&'static str, f64>,
    /// Blocks in use at the end.
    pub(crate) blocks: Option<u32>,
    /// Surfels at the end, where the map is one of them.
    pub(crate) surfels: Option<u32>,
    /// Device memory of the map.
    pub(crate) map_bytes: u64,
    pub(crate) mesh: Option<MeshSummary>,
    /// Of the final trajectory.
    pub(crate) evaluation: Option<Evaluation>,
    /// Of the poses as they were found, where submaps have moved since.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) live_evaluation: Option<Evaluation>,
    pub(crate) submaps: usize,
    pub(crate) closures: usize,
    pub(crate) keyframes: usize,
    pub(crate) mesh_error: Option<MeshError>,
    /// The frames that were not good, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) not_good: Option<Vec<NotGood>>,
    /// What a user should know, frame by frame.
    pub(crate) messages: Vec<Message>,
    pub(crate) out: PathBuf,
}

#[derive(Serialize)]
pub(crate) struct MeshSummary {
    pub(crate) vertices: usize,
    pub(crate) triangles: usize,
    pub(crate) seconds: f64,
}

/// A frame that was not good.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct NotGood {
    pub(crate) frame: u64,
    /// `poor` or `lost`; or `no-depth`, `no-pose` or `skipped`, where the frame was not tracked.
    pub(crate) verdict: &'static str,
    pub(crate) reasons: Vec<String>,
}

impl NotGood {
    pub(crate) fn of(row: &Row) -> Option<Self> {
        Some(Self { frame: row.frame, verdict: row.trouble()?, reasons: row.reasons.clone() })
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Message {
    pub(crate) frame: u64,
    pub(crate) text: String,
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { frames, frames_reached, posed, poor, lost, skipped, .. } = self;
        let share = self.posed_share * 100.0;
        if self.stopped {
            writeln!(f, "stopped after {frames_reached} of {frames} frames")?;
        }
        write!(f, "frames with a pose: {posed} of {frames_reached} ({share:.1} %); ")?;
        write!(f, "{poor} poor, {lost} lost, {skipped} skipped")?;
        if self.not_good.is_none() && poor + lost > 0 {
            write!(f, " (--explain says which and why)")?;
        }
        write!(f, "\ntime: {:.1} s, {:.1} frames/s", self.seconds, self.frames_per_second)?;
        if let Some(ms) = self.median_frame_ms {
            write!(f, ", median {ms:.1} ms a frame on {}", self.device)?;
        }
        if let Some(surfels) = self.surfels {
            write!(f, "\nmap: {surfels} surfels, {} MiB on the device", self.map_bytes >> 20)?;
        }
        if let Some(blocks) = self.blocks {
            write!(f, "\nmap: {blocks} blocks, {} MiB on the device", self.map_bytes >> 20)?;
        }
        match &self.mesh {
            Some(mesh) if mesh.triangles == 0 => write!(f, "\nmesh: empty, as nothing was fused")?,
            Some(MeshSummary { vertices, triangles, seconds }) => {
                write!(f, "\nmesh: {vertices} vertices, {triangles} triangles in {seconds:.1} s")?;
            }
            None => {}
        }
        if let Some(evaluation) = &self.evaluation {
            let (ate, rpe) = (evaluation.ate.rmse * 1e3, evaluation.rpe_translation.rmse * 1e3);
            if let Some(live) = &self.live_evaluation {
                write!(f, "\nlive ATE: {:.2} mm rmse, before the submaps were corrected", live.ate.rmse * 1e3)?;
            }
            let turn = evaluation.rpe_rotation.rmse.to_degrees();
            write!(f, "\nATE: {ate:.2} mm rmse over {} poses ({share:.1} % of the frames have one)", evaluation.pairs)?;
            write!(f, "\nRPE: {rpe:.2} mm, {turn:.3}° rmse a frame")?;
        }
        if let Some(MeshError { median_mm, percentile_99_mm, within_voxel, vertices }) = &self.mesh_error {
            let within = within_voxel * 100.0;
            write!(
                f,
                "\nmesh error: {median_mm:.2} mm median, {percentile_99_mm:.2} mm 99th percentile, {within:.1} % \
                 within a voxel ({vertices} vertices)"
            )?;
        }
        write!(f, "\nresults: {}", self.out.display())
    }
}
