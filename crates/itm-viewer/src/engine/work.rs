//! The thread that has the reconstruction.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::sync::{Arc, atomic::Ordering};
use std::time::Duration;

use itm_io::recording::{self, Recording};
use itm_slam::{Device, Event, FrameReport, Happening, SavedSession, Session, Settings, Slam};

use super::capture::Capture;
use super::open::{Open, OpenAs};
use super::opening::{SEEN, causes, note_report, show_map, show_trajectory};
use super::painter::{Painter, ShownMesh, Subject};
use super::pictures::depth_picture;
use super::results::Results;
use super::state::{Busy, FrameSummary, Kind, Row, Scene, Shown, State};
use super::{Command, Shared};
use crate::keeper::{Keeper, KeeperFor};

/// What is open.
pub(super) enum Opened {
    Nothing,
    Recording(Box<Reconstruction>),
    Map(Box<Slam>),
    Results(Box<Results>, Box<ShownMesh>),
}

impl Opened {
    pub(super) fn slam(&self) -> Option<&Slam> {
        match self {
            Self::Nothing | Self::Results(..) => None,
            Self::Recording(reconstruction) => Some(reconstruction.session.slam()),
            Self::Map(slam) => Some(slam),
        }
    }

    fn slam_mut(&mut self) -> Option<&mut Slam> {
        match self {
            Self::Nothing | Self::Results(..) => None,
            Self::Recording(reconstruction) => Some(reconstruction.session.slam_mut()),
            Self::Map(slam) => Some(slam),
        }
    }

    /// What is painted.
    fn subject(&self) -> Option<&dyn Subject> {
        match self {
            Self::Results(_, mesh) => Some(&**mesh),
            other => other.slam().map(|slam| slam as &dyn Subject),
        }
    }

    fn subject_mut(&mut self) -> Option<&mut dyn Subject> {
        match self {
            Self::Results(_, mesh) => Some(&mut **mesh),
            other => other.slam_mut().map(|slam| slam as &mut dyn Subject),
        }
    }
}

/// A recording that is reconstructed.
pub(super) struct Reconstruction {
    pub(super) open: Open,
    pub(super) session: Session,
    /// Reads single frames, while the session reads ahead; made when first asked for.
    pub(super) preview: Option<Box<dyn Recording>>,
    pub(super) keeper: Option<Box<dyn Keeper>>,
    /// Whether results began to be kept, or would have: no sooner than with the first frame, so that what only is opened costs
    /// no earlier results.
    pub(super) begun: bool,
    pub(super) finished: bool,
}

/// The thread's own.
pub(super) struct Worker {
    pub(super) device: Device,
    pub(super) shared: Arc<Shared>,
    keeper_for: Option<KeeperFor>,
    pub(super) opened: Opened,
    running: bool,
    pub(super) painter: Painter,
    /// Counts what changes the map or its place.
    pub(super) version: u64,
    capture: Option<Capture>,
    /// Why the view could not be shown when it was last tried.
    trouble: Option<String>,
    /// Whether the last frame was told to be lost.
    pub(super) lost: bool,
    /// Whether it was told that the map is full.
    pub(super) full: bool,
}

impl Worker {
    pub(super) fn new(device: Device, shared: Arc<Shared>, keeper_for: Option<KeeperFor>) -> Self {
        let painter = Painter::new(&device);
        // On a software driver one queue serves the window too.
        device.set_paced(device.capabilities().software);
        Self {
            device,
            shared,
            keeper_for,
            opened: Opened::Nothing,
            running: false,
            painter,
            version: 0,
            capture: None,
            trouble: None,
            lost: false,
            full: false,
        }
    }

    /// Works until the window is gone.
    pub(super) fn run(mut self, commands: &Receiver<Command>) {
        while !self.shared.end.load(Ordering::Relaxed) {
            let command = if self.has_work() {
                match commands.try_recv() {
                    Ok(command) => Some(command),
                    Err(TryRecvError::Empty) => None,
                    Err(TryRecvError::Disconnected) => break,
                }
            } else {
                // What rests is painted again, finely, after a while.
                match commands.recv_timeout(if self.rests_soon() {
                    Duration::from_millis(40)
                } else {
                    Duration::from_secs(3600)
                }) {
                    Ok(command) => Some(command),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) => break,
                }
            };
            if let Some(mut command) = command {
                // Of frames that the handle has passed over meanwhile only the last is shown.
                while matches!(command, Command::Preview(_))
                    && let Ok(next) = commands.try_recv()
                {
                    let before = std::mem::replace(&mut command, next);
                    if !matches!(command, Command::Preview(_)) {
                        self.carry_out(before);
                    }
                }
                self.carry_out(command);
                continue;
            }
            self.paint();
            self.note_rest();
            if self.running && !self.waits_for_the_view() {
                self.advance();
            }
        }
        self.set_capture(None);
        self.close();
    }

    /// Whether the view is being moved on a driver that does one thing after the other: then it goes before frames.
    fn waits_for_the_view(&self) -> bool {
        let wish = self.shared.wish();
        wish.moving && wish.free.is_some() && self.device.capabilities().software
    }

    fn has_work(&self) -> bool {
        self.running && !self.waits_for_the_view() || self.is_unfinished()
    }

    /// Says whether the picture is as fine as it gets.
    fn note_rest(&self) {
        let is_finest = !self.is_unfinished() && !self.rests_soon();
        if self.shared.state().is_finest != is_finest {
            self.shared.go_on(|state| state.is_finest = is_finest);
        }
    }

    fn is_unfinished(&self) -> bool {
        let wish = self.shared.wish();
        self.opened.subject().is_some_and(|s| self.painter.is_unfinished(&wish, self.version, self.running, s))
    }

    fn rests_soon(&self) -> bool {
        let wish = self.shared.wish();
        self.opened.subject().is_some_and(|subject| self.painter.rests_soon(&wish, subject))
    }

    fn paint(&mut self) {
        let wish = self.shared.wish();
        let pose = self.shared.state().frame.as_ref().and_then(|frame| frame.world_from_camera);
        let Some(subject) = self.opened.subject_mut() else { return };
        match self.painter.paint(&wish, self.version, self.running, subject, pose) {
            Ok(None) => {}
            Ok(Some(shown)) => {
                self.trouble = None;
                let captured = self.capture.as_mut().map(|capture| capture.take(&self.device, &shown.canvas));
                // A view that is moved is waited for.
                if wish.free.is_some() && (wish.moving || !self.running) {
                    self.shared.change(|state| state.shown = Some(shown));
                } else {
                    self.shared.go_on(|state| state.shown = Some(shown));
                }
                match captured {
                    Some(Ok(pictures)) => self.shared.change(|state| {
                        if let Some((_, taken)) = &mut state.recording {
                            *taken = pictures;
                        }
                    }),
                    Some(Err(reason)) => {
                        self.tell(Kind::Error, format!("recording has ended: {reason}"));
                        // What there is so far is a whole recording.
                        self.set_capture(None);
                    }
                    None => {}
                }
            }
            Err(error) => {
                let trouble = format!("the view cannot be shown: {error}");
                // Once, and not with each frame.
                if self.trouble.as_ref() != Some(&trouble) {
                    self.tell(Kind::Error, trouble.clone());
                }
                self.trouble = Some(trouble);
            }
        }
    }

    fn carry_out(&mut self, command: Command) {
        match command {
            Command::Look => {}
            Command::Open(open) => self.open(*open),
            Command::Restart(mut settings) => {
                if let Opened::Recording(reconstruction) = &self.opened {
                    let run = self.running;
                    let start = match &reconstruction.open.start {
                        // What went on begins anew.
                        OpenAs::GoingOn(_) => OpenAs::Afresh,
                        start => start.clone(),
                    };
                    // Into an empty map something has to be fused, even where that was switched off meanwhile.
                    settings.map.fuse |= start == OpenAs::Afresh;
                    self.open(Open { settings: *settings, run, start, ..reconstruction.open.clone() });
                }
            }
            Command::TrackIn(map) => self.start_in(&map, OpenAs::InMap(map.clone())),
            Command::GoOn(map) => self.start_in(&map, OpenAs::GoingOn(map.clone())),
            Command::Run(run) => self.set_running(run),
            Command::Step => {
                self.set_running(false);
                self.advance();
            }
            Command::Seek(frame) => self.seek(frame),
            Command::Preview(frame) => self.preview(frame),
            Command::Fuse(fuse) => {
                if let Some(slam) = self.opened.slam_mut() {
                    let mut settings = slam.settings().clone();
                    settings.map.fuse = fuse;
                    self.change_settings(&settings);
                }
            }
            Command::Settings(settings) => self.change_settings(&settings),
            Command::Pick(shown, pixel) => self.pick(&shown, pixel),
            Command::Save(path) => self.save(&path),
            Command::Mesh(path) => self.mesh(&path),
            Command::Capture(what) => self.set_capture(what),
        }
    }

    /// Starts the open recording again, in a saved map or after it.
    fn start_in(&mut self, map: &Path, start: OpenAs) {
        let Opened::Recording(reconstruction) = &self.opened else { return };
        match SavedSession::open(map) {
            Ok(saved) => {
                let open = reconstruction.open.clone();
                let poses = if matches!(start, OpenAs::GoingOn(_)) { saved.poses } else { open.poses };
                self.open(Open { settings: saved.settings, poses, start, run: true, ..open });
            }
            Err(error) => self.tell(Kind::Error, causes(&error)),
        }
    }

    pub(super) fn tell(&self, kind: Kind, text: impl Into<String>) {
        self.shared.change(|state| state.say(None, kind, text));
    }

    pub(super) fn busy(&self, what: Option<&str>) {
        self.shared.change(|state| state.busy = what.map(|what| Busy { what: what.to_owned(), done: None }));
    }

    pub(super) fn set_running(&mut self, run: bool) {
        let can = matches!(&self.opened, Opened::Recording(reconstruction) if !reconstruction.finished);
        self.running = run && can;
        let running = self.running;
        self.shared.change(|state| state.running = running);
    }

    fn begin_keeping(&mut self, reconstruction: &mut Reconstruction) {
        let Some(keeper_for) = &mut self.keeper_for else { return };
        match keeper_for(&reconstruction.open.path, &mut reconstruction.session) {
            Ok(keeper) => reconstruction.keeper = Some(keeper),
            Err(reason) => self.tell(Kind::Warning, format!("results are not kept: {reason}")),
        }
    }

    /// Keeps what was reconstructed, and lets go of it.
    pub(super) fn close(&mut self) {
        let opened = std::mem::replace(&mut self.opened, Opened::Nothing);
        if let Opened::Recording(mut reconstruction) = opened
            && reconstruction.session.frame().is_some()
        {
            if !reconstruction.finished {
                // The last event, which tells the keeper that no more frames come.
                reconstruction.session.stop_switch().store(true, Ordering::Relaxed);
                while let Some(event) = reconstruction.session.next() {
                    self.keep(&mut reconstruction, &event);
                }
            }
            if !reconstruction.finished {
                self.finish_keeping(&mut reconstruction);
            }
        }
        self.running = false;
    }

    fn keep(&self, reconstruction: &mut Reconstruction, event: &Event) {
        if let Some(keeper) = &mut reconstruction.keeper
            && let Err(reason) = keeper.event(event, &mut reconstruction.session)
        {
            reconstruction.keeper = None;
            self.tell(Kind::Warning, format!("results are not kept any more: {reason}"));
        }
    }

    fn finish_keeping(&self, reconstruction: &mut Reconstruction) {
        let Some(keeper) = &mut reconstruction.keeper else { return };
        self.busy(Some("writing the results"));
        let kept = keeper.finish(&mut reconstruction.session);
        self.busy(None);
        match kept {
            Ok(folder) => self.tell(Kind::Done, format!("results are in {}", folder.display())),
            Err(reason) => self.tell(Kind::Error, format!("results were not all written: {reason}")),
        }
    }

    /// Processes the next frame.
    fn advance(&mut self) {
        let mut opened = std::mem::replace(&mut self.opened, Opened::Nothing);
        if let Opened::Recording(reconstruction) = &mut opened {
            if !std::mem::replace(&mut reconstruction.begun, true) {
                self.begin_keeping(reconstruction);
            }
            match reconstruction.session.next() {
                Some(event) => {
                    self.take(reconstruction, &event);
                    self.keep(reconstruction, &event);
                    if matches!(event, Event::Finished(_)) {
                        reconstruction.finished = true;
                        self.finish_keeping(reconstruction);
                        self.running = false;
                        let trajectory = reconstruction.session.slam_mut().corrected_trajectory();
                        self.version += 1;
                        self.shared.change(|state| {
                            state.running = false;
                            show_map(state, reconstruction.session.slam());
                            show_trajectory(state, &trajectory);
                            if let Scene::Recording { finished, .. } = &mut state.scene {
                                *finished = true;
                            }
                        });
                    }
                }
                None => self.running = false,
            }
        }
        self.opened = opened;
    }

    /// Says what an event tells.
    fn take(&mut self, reconstruction: &mut Reconstruction, event: &Event) {
        let session = &mut reconstruction.session;
        let (_, following) = session.place();
        let place = |state: &mut State| {
            if let Scene::Recording { next, .. } = &mut state.scene {
                *next = following;
            }
        };
        match event {
            Event::Skipped { index, reason } => {
                let (index, reason) = (*index as u64, reason.clone());
                self.shared.go_on(|state| {
                    place(state);
                    state.rows.push(Row { frame: index, ..Row::default() });
                    state.say(Some(index), Kind::Warning, format!("skipped: {reason}"));
                });
            }
            Event::Warning(warning) => self.tell(Kind::Warning, warning.to_string()),
            Event::Finished(summary) => {
                let mut text = format!("no more frames: {} of {} have a pose", summary.posed, summary.frames);
                let mut kind = Kind::Done;
                if let Some(error) = &summary.error {
                    text = format!("the reconstruction has ended: {error}");
                    kind = Kind::Error;
                }
                self.shared.change(|state| {
                    summary.reports.iter().for_each(|report| note_report(state, report));
                    state.say(None, kind, text);
                });
            }
            Event::Frame { result, total_ms } => {
                let colour = session.frame().and_then(|frame| frame.colour.clone()).map(Arc::new);
                let settings = session.slam().settings();
                let range_m = [settings.view.min_depth_m, settings.view.max_depth_m];
                let calibration = *session.slam().calibration();
                let depth = session.frame().map(|frame| Arc::new(depth_picture(&frame.depth, &calibration, range_m)));
                let moved = result.happenings.iter().any(|h| matches!(h, Happening::Optimised(_)));
                let trajectory = moved.then(|| session.slam().corrected_trajectory());
                let summary = FrameSummary::of(result);
                let lost = matches!(summary.verdict, super::state::Verdict::Lost);
                let news = (lost != self.lost).then(|| match lost {
                    true => (Kind::Warning, format!("tracking lost: {}", summary.reasons.join("; "))),
                    false => (Kind::Event, "tracked again".to_owned()),
                });
                self.lost = lost;
                let map_mib = session.slam().map_bytes() as f64 / f64::from(1 << 20);
                let notices = self.notices(result.report.as_ref());
                self.version += 1;
                self.shared.go_on(|state| {
                    place(state);
                    (state.depth, state.colour) = (depth, colour);
                    state.rows.push(Row {
                        frame: result.index,
                        total_ms: Some(*total_ms),
                        stages_ms: result
                            .tracked
                            .as_ref()
                            .map(|_| ("track".into(), result.track_ms))
                            .into_iter()
                            .collect(),
                        map_mib: Some(map_mib),
                        residual_mm: result.tracked.as_ref().map(|t| t.rms_m * 1e3).filter(|mm| mm.is_finite()),
                        verdict: result.tracked.as_ref().map(|_| summary.verdict),
                        ..Row::default()
                    });
                    if let Some(report) = &result.report {
                        note_report(state, report);
                    }
                    if let Some(pose) = &summary.world_from_camera {
                        Arc::make_mut(&mut state.trajectory).push(pose.translation);
                        state.reach(pose.translation);
                        state.reach(pose.transform_point(glam::DVec3::Z * f64::from(SEEN * range_m[1])));
                    }
                    if let Some(trajectory) = &trajectory {
                        show_trajectory(state, trajectory);
                    }
                    if !result.happenings.is_empty() {
                        show_map(state, session.slam());
                    }
                    if let Some((kind, text)) = news {
                        state.say(Some(result.index), kind, text);
                    }
                    for happening in &result.happenings {
                        if !matches!(happening, Happening::Keyframe { .. }) {
                            state.say(Some(result.index), Kind::Event, happening.to_string());
                        }
                    }
                    for notice in notices {
                        state.say(Some(result.index), Kind::Warning, notice);
                    }
                    state.frame = Some(summary);
                });
            }
            _ => {}
        }
    }

    /// What a report has to tell: of a full map once.
    fn notices(&mut self, report: Option<&FrameReport>) -> Vec<String> {
        let Some(report) = report else { return Vec::new() };
        let full = !report.notices.is_empty();
        let new = full && !self.full;
        self.full = full;
        if new { report.notices.iter().map(ToString::to_string).collect() } else { Vec::new() }
    }

    fn seek(&mut self, frame: usize) {
        let Opened::Recording(reconstruction) = &mut self.opened else { return };
        if let Err(error) = reconstruction.session.seek(frame) {
            return self.tell(Kind::Error, error.to_string());
        }
        reconstruction.finished = false;
        self.shared.change(|state| {
            if let Scene::Recording { next, finished, .. } = &mut state.scene {
                (*next, *finished) = (frame, false);
            }
        });
        self.preview(frame);
    }

    fn preview(&mut self, frame: usize) {
        let Opened::Recording(reconstruction) = &mut self.opened else { return };
        if reconstruction.preview.is_none() {
            match recording::open(&reconstruction.open.path, &reconstruction.open.options) {
                Ok(recording) => reconstruction.preview = Some(recording),
                Err(error) => return self.tell(Kind::Warning, causes(&error)),
            }
        }
        let Some(recording) = &mut reconstruction.preview else { return };
        match recording.read(frame) {
            Ok(frame) => {
                let settings = &reconstruction.session.slam().settings().view;
                let range_m = [settings.min_depth_m, settings.max_depth_m];
                let depth = depth_picture(&frame.depth, &recording.info().calibration, range_m);
                self.shared.change(|state| {
                    state.depth = Some(Arc::new(depth));
                    state.colour = frame.colour.map(Arc::new);
                });
            }
            Err(error) => self.tell(Kind::Warning, error.to_string()),
        }
    }

    fn change_settings(&mut self, wanted: &Settings) {
        let (slam, wanted) = match &mut self.opened {
            Opened::Nothing | Opened::Results(..) => return,
            // What the recording cannot fill is no difference.
            Opened::Recording(reconstruction) => {
                let Reconstruction { session, open, .. } = &mut **reconstruction;
                let wanted = Session::fit(wanted, session.info(), open.poses);
                (session.slam_mut(), wanted)
            }
            Opened::Map(slam) => (&mut **slam, wanted.clone()),
        };
        if let Err(error) = slam.change_settings(&wanted) {
            // They hold together with others only, which need a restart: the panel says so.
            tracing::debug!("settings are not taken over: {error}");
        }
        let settings = slam.settings().clone();
        self.shared.change(|state| {
            state.fusing = settings.map.fuse;
            state.settings = settings;
        });
    }

    fn pick(&mut self, shown: &Shown, pixel: (u32, u32)) {
        match shown.canvas.depth(&self.device, pixel) {
            Ok(depth) => {
                let point = depth.map(|z| {
                    let pixel = glam::DVec2::new(pixel.0.into(), pixel.1.into());
                    shown.world_from_camera.transform_point(shown.camera.unproject(pixel, z.into()))
                });
                self.shared.change(|state| state.picked = (state.picked.0 + 1, point));
            }
            Err(error) => self.tell(Kind::Error, error.to_string()),
        }
    }

    fn save(&mut self, path: &Path) {
        self.busy(Some("saving the map"));
        let saved = self.opened.slam_mut().map(|slam| slam.save(path));
        self.busy(None);
        match saved {
            None => self.tell(Kind::Error, "there is no map to save"),
            Some(Ok(())) => self.tell(Kind::Done, format!("the map is saved in {}", path.display())),
            Some(Err(error)) => self.tell(Kind::Error, format!("the map is not saved: {}", causes(&error))),
        }
    }

    fn mesh(&mut self, path: &Path) {
        // What can be wrong with the file is found before the work.
        if let Err(error) = itm_io::mesh::check_name(path) {
            return self.tell(Kind::Error, error.to_string());
        }
        self.busy(Some("meshing"));
        let shared = Arc::clone(&self.shared);
        let mut progress = |done: u32, of: u32| {
            let share = done as f32 / of.max(1) as f32;
            shared.change(|state| state.busy = Some(Busy { what: "meshing".into(), done: Some(share) }));
        };
        let written = self.opened.slam_mut().map(|slam| {
            let mesh = slam.mesh(&mut progress).map_err(|error| causes(&error))?;
            itm_io::mesh::write(path, &mesh, &itm_io::mesh::WriteOptions::default()).map_err(|error| causes(&error))?;
            Ok::<_, String>(mesh.triangles.len())
        });
        self.busy(None);
        match written {
            None => self.tell(Kind::Error, "there is no map to make a mesh of"),
            Some(Ok(triangles)) => {
                self.tell(Kind::Done, format!("a mesh of {triangles} triangles is in {}", path.display()));
            }
            Some(Err(error)) => self.tell(Kind::Error, format!("no mesh: {error}")),
        }
    }

    fn set_capture(&mut self, what: Option<(super::CaptureKind, PathBuf)>) {
        if let Some(capture) = self.capture.take() {
            let ended = capture.finish();
            self.shared.change(|state| {
                state.recording = None;
                match ended {
                    Ok(text) => state.say(None, Kind::Done, text),
                    Err(reason) => state.say(None, Kind::Error, format!("the recording is not whole: {reason}")),
                }
            });
        }
        self.painter.recorded = false;
        let Some((kind, path)) = what else { return };
        match Capture::begin(kind, &path) {
            Ok(capture) => {
                self.capture = Some(capture);
                self.painter.recorded = true;
                self.painter.forget();
                self.shared.change(|state| state.recording = Some((path, 0)));
            }
            Err(reason) => self.tell(Kind::Error, reason),
        }
    }
}
