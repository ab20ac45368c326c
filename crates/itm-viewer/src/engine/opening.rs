//! Opening recordings, maps and results; and what is said of what is open.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use itm_gpu::mesh_view::MeshView;
use itm_io::map_file::MapReader;
use itm_io::recording;
use itm_slam::{
    FrameReport, SavedSession, Se3, Session, SessionOptions, Settings, Slam, Start, Trajectory, full_confidence,
    settings_of,
};

use super::open::{Open, OpenAs, WhatItIs, recognise};
use super::painter::ShownMesh;
use super::results::Results;
use super::state::{FrameSummary, Kind, Scene, State, SubmapSummary, Verdict};
use super::work::{Opened, Reconstruction, Worker};

/// How far ahead of the camera what is seen lies mostly, as a share of the farthest depth.
pub(super) const SEEN: f32 = 0.45;

impl Worker {
    /// Opens something in place of what is open. Where that fails, what is open stays, but for a restart's settings.
    pub(super) fn open(&mut self, open: Open) {
        self.busy(Some(&format!("opening {}", open.path.display())));
        let opened = recognise(&open.path).and_then(|what| match what {
            WhatItIs::Recording => self.open_recording(&open),
            WhatItIs::Map => self.open_map(&open.path),
            WhatItIs::Results => self.open_results(&open.path),
        });
        self.busy(None);
        match opened {
            Ok((opened, scene)) => {
                self.close();
                self.opened = opened;
                self.version += 1;
                self.painter.forget();
                (self.lost, self.full) = (false, false);
                self.show_opened(scene, open.path);
                self.set_running(open.run);
            }
            Err(reason) => self.tell(Kind::Error, reason),
        }
    }

    fn open_recording(&self, open: &Open) -> Result<(Opened, Scene), String> {
        let told = |error: &dyn std::error::Error| causes(error);
        let recording = recording::open(&open.path, &open.options).map_err(|error| told(&error))?;
        let (first, end) = open.frames;
        let all = Some(first..end.unwrap_or(recording.info().frames));
        let (start, frames) = match &open.start {
            OpenAs::Afresh => (Start::Afresh, all),
            OpenAs::InMap(path) => (Start::InMap { path: path.clone(), world_from_camera: None }, all),
            // Those that are left.
            OpenAs::GoingOn(path) => (Start::Resume(path.clone()), None),
        };
        let options = SessionOptions { settings: open.settings.clone(), poses: open.poses, frames, start };
        let session = Session::new(&self.device, recording, &options).map_err(|error| told(&error))?;
        let info = session.info();
        let (frames, next) = session.place();
        let scene = Scene::Recording {
            name: info.name.clone(),
            about: format!(
                "{}, {} frames, depth {}x{}{}; {}",
                info.format,
                info.frames,
                info.calibration.depth.width,
                info.calibration.depth.height,
                if info.has_colour { ", with colour" } else { "" },
                info.calibration_source,
            ),
            depth_camera: info.calibration.depth,
            frames,
            next,
            finished: false,
        };
        let reconstruction =
            Reconstruction { open: open.clone(), session, preview: None, keeper: None, begun: false, finished: false };
        Ok((Opened::Recording(Box::new(reconstruction)), scene))
    }

    fn open_map(&self, path: &Path) -> Result<(Opened, Scene), String> {
        let header = MapReader::open(path).map_err(|error| causes(&error))?.header().clone();
        // A map that no session wrote, as one of submaps that were fused, begins one.
        let slam = match SavedSession::open(path) {
            Ok(_) => Slam::resume(&self.device, path),
            Err(_) => {
                let settings = settings_of(&header, path).unwrap_or_else(|error| {
                    self.tell(
                        Kind::Warning,
                        format!("the map's settings are not all known, so the defaults hold: {error}"),
                    );
                    Settings::default()
                });
                Slam::in_map(&self.device, &header.calibration, &settings, path, Some(&Se3::IDENTITY))
            }
        };
        let slam = slam.map_err(|error| causes(&error))?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let about = format!(
            "a map of mode {}, voxels of {} mm, made from {} frames",
            slam.settings().mode.name(),
            header.voxel_size_m * 1e3,
            header.counts.frames
        );
        let scene = Scene::Map { name, about, depth_camera: slam.calibration().depth };
        Ok((Opened::Map(Box::new(slam)), scene))
    }

    fn open_results(&self, path: &Path) -> Result<(Opened, Scene), String> {
        let mut results = Results::read(path)?;
        for warning in &results.warnings {
            self.tell(Kind::Warning, warning.clone());
        }
        let mesh = results.mesh.as_ref().map(|mesh| MeshView::new(&self.device, mesh)).transpose();
        let settings = &results.settings;
        let shown = ShownMesh {
            device: self.device.clone(),
            mesh: mesh.map_err(|error| causes(&error))?,
            full_confidence: full_confidence(settings),
            reach_m: settings.view.max_depth_m,
        };
        // It lies on the device now; how far it reaches is still to be known.
        results.bounds = results.mesh.take().and_then(|mesh| mesh.bounds());
        let scene = Scene::Results { name: results.name.clone(), about: results.about.clone() };
        Ok((Opened::Results(Box::new(results), Box::new(shown)), scene))
    }

    /// Says what was opened, and nothing of what was open before.
    fn show_opened(&mut self, scene: Scene, path: PathBuf) {
        let mut fresh = State { scene, ..State::default() };
        let mut paces = Vec::new();
        if let Some(slam) = self.opened.slam() {
            fresh.settings = slam.settings().clone();
            fresh.asked = match &self.opened {
                Opened::Recording(reconstruction) => reconstruction.open.settings.clone(),
                _ => slam.settings().clone(),
            };
            fresh.fusing = slam.settings().map.fuse;
            show_map(&mut fresh, slam);
            let trajectory = slam.corrected_trajectory();
            show_trajectory(&mut fresh, &trajectory);
            if matches!(self.opened, Opened::Map(_)) {
                paces = trajectory.poses().to_vec();
            }
        }
        if let Opened::Results(results, _) = &self.opened {
            fresh.settings = results.settings.clone();
            fresh.rows = results.rows.clone();
            paces.clone_from(&results.trajectory);
            show_trajectory(&mut fresh, &Trajectory::new(results.trajectory.clone()));
            if let Some((min, max)) = results.bounds {
                fresh.bounds = Some((min.as_dvec3(), max.as_dvec3()));
            }
        }
        if let Some(last) = paces.last() {
            // A map is followed from where its camera was last.
            fresh.frame = Some(FrameSummary {
                index: 0,
                verdict: Verdict::Unjudged,
                reasons: Vec::new(),
                world_from_camera: Some(last.world_from_camera),
            });
        }
        self.shared.change(|state| {
            fresh.messages = std::mem::take(&mut state.messages);
            fresh.told = state.told;
            fresh.opened = (state.opened.0 + 1, path);
            fresh.picked = state.picked;
            fresh.recording = state.recording.take();
            *state = fresh;
            let name = state.scene.name().unwrap_or_default().to_owned();
            state.say(None, Kind::Event, format!("opened {name}"));
        });
    }
}

/// An error with what caused it, in one line.
pub(super) fn causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

pub(super) fn note_report(state: &mut State, report: &FrameReport) {
    let Some(row) = state.rows.iter_mut().rev().find(|row| row.frame == report.index) else { return };
    row.stages_ms.extend(report.stage_ms.iter().map(|(stage, ms)| ((*stage).into(), *ms)));
    row.size = Some(match &report.surfels {
        Some(record) => record.used.saturating_sub(record.free),
        None => report.record.blocks.saturating_sub(report.record.free_blocks),
    });
}

/// Where submaps and keyframes are.
pub(super) fn show_map(state: &mut State, slam: &Slam) {
    let submaps = slam.submaps();
    state.submaps = submaps
        .iter()
        .map(|submap| SubmapSummary { world_from_submap: submap.world_from_submap, state: submap.state })
        .collect();
    state.links = slam.submap_links().iter().map(|link| (link.from, link.to, link.closure)).collect();
    let in_world = |submap: u16| submaps.get(usize::from(submap)).map(|s| s.world_from_submap).unwrap_or_default();
    let keyframes = slam.keyframes().iter().map(|k| in_world(k.submap) * k.submap_from_camera);
    state.keyframes = Arc::new(keyframes.collect());
}

pub(super) fn show_trajectory(state: &mut State, trajectory: &Trajectory) {
    let places: Vec<_> = trajectory.poses().iter().map(|pose| pose.world_from_camera.translation).collect();
    let ahead = f64::from(SEEN * state.settings.view.max_depth_m);
    for pose in trajectory.poses() {
        state.reach(pose.world_from_camera.translation);
        state.reach(pose.world_from_camera.transform_point(glam::DVec3::Z * ahead));
    }
    state.trajectory = Arc::new(places);
}
