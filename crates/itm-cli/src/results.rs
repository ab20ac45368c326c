//! The folder of a run's results: what is written at the end.

use std::collections::BTreeSet;
use std::fs::{self, OpenOptions};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Error, Result, bail};
use clap::ValueEnum;
use itm_core::{Mesh, Se3, Trajectory, evaluation};
use itm_io::mesh::{UpAxis, WriteOptions};
use itm_slam::{Keyframe, Poses, Session};
use serde_json::json;

use crate::log::Log;
use crate::mesh_error::{self, MeshError};
use crate::summary::{MeshSummary, NotGood, Summary};
use crate::timings::{self, Row, STAGES};
use crate::{console, pictures, report};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MeshFormat {
    /// Binary, with colours and weights
    Ply,
    /// Text, with colours
    Obj,
    /// Binary, shape only
    Stl,
    /// glTF, binary, with colours
    Glb,
}

impl MeshFormat {
    fn file_name(self) -> &'static str {
        match self {
            Self::Ply => "mesh.ply",
            Self::Obj => "mesh.obj",
            Self::Stl => "mesh.stl",
            Self::Glb => "mesh.glb",
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum UpArgument {
    /// The camera's axes: x right, y down, z forward
    YDown,
    /// As in glTF and most viewers
    YUp,
    /// As in ROS, CAD and Blender
    ZUp,
}

impl From<UpArgument> for UpAxis {
    fn from(up: UpArgument) -> Self {
        match up {
            UpArgument::YDown => Self::YDown,
            UpArgument::YUp => Self::YUp,
            UpArgument::ZUp => Self::ZUp,
        }
    }
}

/// Makes the folder, finds out whether it can be written, and removes what an earlier run wrote at its end, so that
/// results of two runs are never mixed.
pub(crate) fn prepare_folder(out: &Path, recording: &Path) -> Result<()> {
    let shown = out.display();
    if out.exists() && !out.is_dir() {
        bail!("the output '{shown}' is a file; name a folder");
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make the output folder '{shown}'"))?;
    if out.canonicalize().ok().is_some_and(|out| recording.canonicalize().is_ok_and(|recording| recording == out)) {
        bail!("the output '{shown}' is the recording itself; name another folder");
    }
    let probe = out.join(format!(".itm-{}.part", std::process::id()));
    let written = OpenOptions::new().write(true).create_new(true).open(&probe);
    written.with_context(|| format!("cannot write to the output folder '{shown}'"))?;
    fs::remove_file(&probe).with_context(|| format!("cannot remove '{}'", probe.display()))?;
    let meshes = MeshFormat::value_variants().iter().map(|format| format.file_name());
    for name in meshes.chain(["report.html", "metrics.json"]) {
        let path = out.join(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot replace '{}'", path.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

/// What is written at the end of a run, and where.
pub(crate) struct Results {
    pub(crate) recording: PathBuf,
    pub(crate) out: PathBuf,
    /// The device's name.
    pub(crate) device: String,
    pub(crate) poses: Poses,
    /// None for no mesh.
    pub(crate) mesh_formats: Vec<MeshFormat>,
    pub(crate) up: Option<UpAxis>,
    pub(crate) save: Option<PathBuf>,
    pub(crate) explain: bool,
    pub(crate) quiet: bool,
}

impl Results {
    /// Writes what is there, whatever of it cannot be written: the summary's errors say so.
    pub(crate) fn write(&self, session: &mut Session, log: &mut Log, ended: &itm_slam::Summary) -> Summary {
        let info = session.info().clone();
        let mut errors: Vec<Error> =
            log.failure.take().into_iter().chain(ended.error.clone().map(Error::msg)).collect();
        let mut keep = |result: Result<()>| errors.extend(result.err());
        keep(log.timings.finish(&ended.reports).context("cannot write timings.csv"));
        if let Some(path) = &self.save {
            keep(
                session.slam_mut().save(path).with_context(|| format!("the map is not saved in '{}'", path.display())),
            );
        }
        keep(log.write_changed_settings(&self.out, session.slam().settings()));
        let settled = session.slam_mut().settle();
        let live = session.slam().trajectory().last_of_each_time();
        let trajectory = session.slam().corrected_trajectory().last_of_each_time();
        // Where a recording was gone back in, frames have several poses in the file that grew.
        let grew = !log.rewritten && live.len() == session.slam().trajectory().len();
        let file = |name: &str| self.out.join(name);
        if let Some(happening) = &settled {
            log.say(log.last_frame(), happening.to_string());
            if grew {
                keep(log.write_corrected(&self.out, &trajectory));
            } else {
                keep(log.write_trajectory(&file("trajectory_live.txt"), &live));
                keep(log.write_trajectory(&file("trajectory.txt"), &trajectory));
            }
        } else if !grew {
            keep(log.write_trajectory(&file("trajectory.txt"), &live));
        }
        let mut mesh = None;
        if !self.mesh_formats.is_empty() {
            keep(self.write_mesh(session).map(|written| mesh = Some(written)));
        }
        let mut evaluate = |trajectory: &Trajectory| match (&info.ground_truth, self.poses) {
            (Some(truth), Poses::Tracked) => evaluation::evaluate(trajectory, truth, evaluation::DEFAULT_TOLERANCE_NS)
                .map_err(|error| log.say(log.last_frame(), format!("no ATE: {error}")))
                .ok(),
            _ => None,
        };
        let evaluation = evaluate(&trajectory);
        let live_evaluation = settled.is_some().then(|| evaluate(&live)).flatten();
        let truth_from_mesh = match (&info.ground_truth, self.poses) {
            (_, Poses::Given) => Some(Se3::IDENTITY),
            (Some(truth), Poses::Tracked) => mesh_error::align_poses(&trajectory, truth),
            (None, Poses::Tracked) => None,
        };
        let scene = mesh_error::scene_of(&self.recording);
        let mesh_error =
            mesh.as_ref().zip(truth_from_mesh).zip(scene).and_then(|(((mesh, _), truth_from_mesh), scene)| {
                MeshError::measure(mesh, &scene, &truth_from_mesh, session.slam_mut().settings().map.voxel_size_m)
            });

        let rows = log.timings.rows();
        let reached = rows.iter().map(|row| row.frame).collect::<BTreeSet<_>>().len();
        let median_of = |value: &dyn Fn(&Row) -> Option<f64>| timings::median(rows.iter().filter_map(value));
        let median_stage = |(i, stage)| Some((stage, median_of(&|row: &Row| row.stage_ms[i])?));
        let mut summary = Summary {
            recording: info.name.clone(),
            format: info.format.to_string(),
            calibration: info.calibration_source.clone(),
            recording_frames: info.frames,
            has_colour: info.has_colour,
            has_gyroscope: info.has_gyroscope,
            device: self.device.clone(),
            poses: if self.poses == Poses::Tracked { "tracked" } else { "given" },
            frames: ended.frames,
            frames_reached: reached,
            posed: ended.posed,
            posed_share: ended.posed as f64 / reached.max(1) as f64,
            poor: ended.poor,
            lost: ended.lost,
            skipped: ended.skipped,
            stopped: ended.stopped,
            errors: errors.iter().map(|e| format!("{e:#}")).collect(),
            seconds: ended.seconds,
            frames_per_second: rows.len() as f64 / ended.seconds.max(1e-9),
            median_frame_ms: median_of(&|row| row.total_ms),
            median_stage_ms: STAGES.into_iter().enumerate().filter_map(median_stage).collect(),
            blocks: rows.iter().rev().find_map(|row| row.blocks),
            surfels: rows.iter().rev().find_map(|row| row.surfels),
            map_bytes: session.slam_mut().map_bytes(),
            mesh: mesh.as_ref().map(|(mesh, seconds)| MeshSummary {
                vertices: mesh.positions.len(),
                triangles: mesh.triangles.len(),
                seconds: *seconds,
            }),
            evaluation,
            live_evaluation,
            submaps: session.slam_mut().submaps().len().max(1),
            closures: session.slam_mut().submap_links().iter().filter(|link| link.closure).count(),
            keyframes: session.slam_mut().keyframes().len(),
            mesh_error,
            not_good: self.explain.then(|| rows.iter().filter_map(NotGood::of).collect()),
            messages: log.messages.clone(),
            out: self.out.clone(),
        };
        if let Err(error) = write_metrics(&summary) {
            summary.errors.push(format!("{error:#}"));
        }
        let pictures = pictures::of(session.slam_mut(), mesh.as_ref().map(|(mesh, _)| mesh));
        let submaps = session.slam_mut().submaps().to_vec();
        let in_world = |keyframe: &Keyframe| {
            let submap = submaps.get(usize::from(keyframe.submap)).map(|submap| submap.world_from_submap);
            (submap.unwrap_or_default() * keyframe.submap_from_camera).translation
        };
        let keyframes: Vec<_> = session.slam_mut().keyframes().iter().map(in_world).collect();
        let page = report::Report {
            submaps: &submaps,
            links: &session.slam_mut().submap_links(),
            keyframes: &keyframes,
            summary: &summary,
            rows,
            trajectory: &trajectory,
            info: &info,
            pictures: &pictures,
            settings: &session.slam_mut().settings().to_toml(),
        };
        if let Err(error) = report::write(&self.out.join("report.html"), &page) {
            summary.errors.push(format!("{error:#}"));
        }
        summary
    }

    /// Extracts the mesh and writes it; returns it with the seconds that took.
    fn write_mesh(&self, session: &mut Session) -> Result<(Mesh, f64)> {
        let started = Instant::now();
        let bar = console::bar(0, "blocks meshed", self.quiet);
        let mesh = session.mesh(&mut |done, all| {
            bar.set_length(all.into());
            bar.set_position(done.into());
        });
        bar.finish_and_clear();
        let mesh = mesh.context("no mesh")?;
        let options = WriteOptions { up: self.up };
        for format in &self.mesh_formats {
            itm_io::mesh::write(&self.out.join(format.file_name()), &mesh, &options)?;
        }
        Ok((mesh, started.elapsed().as_secs_f64()))
    }
}

/// Writes what was measured against the truth, where anything was.
fn write_metrics(summary: &Summary) -> Result<()> {
    let Summary { frames_reached, posed, posed_share, poor, lost, evaluation, mesh_error, out, .. } = summary;
    let Summary { live_evaluation, submaps, closures, keyframes, .. } = summary;
    if evaluation.is_none() && mesh_error.is_none() {
        return Ok(());
    }
    let path = out.join("metrics.json");
    let metrics = json!({
        "frames": frames_reached,
        "posed": posed,
        "posed_share": posed_share,
        "poor": poor,
        "lost": lost,
        "evaluation": evaluation,
        "live_evaluation": live_evaluation,
        "submaps": submaps,
        "closures": closures,
        "keyframes": keyframes,
        "mesh_error": mesh_error,
    });
    fs::write(&path, format!("{metrics:#}\n")).with_context(|| format!("cannot write '{}'", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_an_earlier_run_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a/b");
        prepare_folder(&out, folder.path()).unwrap();
        for name in ["mesh.ply", "notes.txt", "trajectory.txt"] {
            fs::write(out.join(name), "").unwrap();
        }
        prepare_folder(&out, folder.path()).unwrap();
        assert!(!out.join("mesh.ply").exists() && out.join("notes.txt").exists());
        let error = prepare_folder(folder.path(), folder.path()).unwrap_err().to_string();
        assert!(error.contains("is the recording itself"), "{error}");
    }
}
