//! Running over a recording as a stream of events.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use itm_core::{Frame, Mesh, Se3, Settings, SettingsError, Timestamp, TrackerKind, TrackerSettings};
use itm_io::recording::{ReadAhead, Recording, RecordingInfo};
use itm_io::trajectory::PoseFiles;

use crate::{Device, Error, FrameReport, FrameResult, FrameStatus, Poses, SavedSession, Slam, Warning};

/// How a recording is run.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// Settings.
    pub settings: Settings,
    /// Where poses come from.
    pub poses: Poses,
    /// Which frames, by their place in the recording; `None` for all, or all that are left where a session goes on.
    pub frames: Option<Range<usize>>,
    /// What the run starts from.
    pub start: Start,
}

/// Default settings, tracked poses, all frames, an empty map.
impl Default for SessionOptions {
    fn default() -> Self {
        Self { settings: Settings::default(), poses: Poses::Tracked, frames: None, start: Start::Afresh }
    }
}

/// What a run starts from.
#[derive(Clone, Debug, Default)]
pub enum Start {
    /// An empty map. The first frame's camera is the world's origin.
    #[default]
    Afresh,
    /// A saved session, which goes on. Its settings, its calibration and where its poses come from are its own, whatever
    /// the options say.
    Resume(PathBuf),
    /// A saved map.
    InMap {
        /// The map file.
        path: PathBuf,
        /// Where the first frame's depth camera is, or nearly; `None` to find it by the map's keyframes.
        world_from_camera: Option<Se3>,
    },
}

/// What happens in a run, in order.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "an event is moved once, and nearly all of them are frames")]
#[non_exhaustive]
pub enum Event {
    /// A frame was processed.
    Frame {
        /// What was found.
        result: FrameResult,
        /// Milliseconds from taking the decoded frame to the end of its processing on the host.
        total_ms: f64,
    },
    /// A frame could not be read or used; it was counted and skipped.
    Skipped {
        /// Its place in the recording.
        index: usize,
        /// Why.
        reason: String,
    },
    /// Something was no use, and is left out.
    Warning(Warning),
    /// No more frames come. Sent once, last.
    Finished(Summary),
}

/// A run in numbers.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Summary {
    /// Frames that were asked for.
    pub frames: usize,
    /// Frames with a pose.
    pub posed: usize,
    /// Frames whose pose may be off.
    pub poor: usize,
    /// Frames whose tracking failed.
    pub lost: usize,
    /// Frames that could not be read or used.
    pub skipped: usize,
    /// Whether the run was stopped before its last frame.
    pub stopped: bool,
    /// Wall time from the first frame to the last, in seconds.
    pub seconds: f64,
    /// Reports that no frame's result carries.
    pub reports: Vec<FrameReport>,
    /// What ended the run before its last frame, where something did.
    pub error: Option<String>,
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, Default)]
struct Met {
    posed: bool,
    poor: bool,
    lost: bool,
    skipped: bool,
}

/// A run over a recording: an iterator over its events. Frames are decoded ahead on another thread. (The class of that name in
/// the Python package is [`Slam`]: its caller iterates.)
///
/// ```no_run
/// use itm_slam::{Device, Event, Session, SessionOptions, io};
/// # fn main() -> Result<(), itm_slam::Error> {
/// let recording = io::recording::open("rgbd_dataset_freiburg1_desk".as_ref(), &io::recording::OpenOptions::default())?;
/// let mut session = Session::new(&Device::open("auto")?, recording, &SessionOptions::default())?;
/// for event in &mut session {
///     match event {
///         Event::Frame { result, .. } => println!("{}: {:?}", result.index, result.world_from_camera),
///         Event::Finished(summary) => println!("{} of {} frames have a pose", summary.posed, summary.frames),
///         _ => {}
///     }
/// }
/// let mut slam = session.into_slam();
/// slam.save("desk.itm".as_ref())?;
/// # Ok(())
/// # }
/// ```
pub struct Session {
    slam: Slam,
    info: RecordingInfo,
    frames: ReadAhead,
    range: Range<usize>,
    /// The frame that comes next.
    next: usize,
    /// The last frame that was processed.
    frame: Option<Frame>,
    summary: Summary,
    /// What became of each frame, by its place, when it was last processed.
    met: BTreeMap<usize, Met>,
    started: Option<Instant>,
    finished: bool,
    stop: Arc<AtomicBool>,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("recording", &self.info.name).field("next", &self.next).finish_non_exhaustive()
    }
}

impl Session {
    /// Prepares a run; nothing is processed before the first event is asked for.
    ///
    /// # Errors
    /// As [`Session::check`]; also where the calibration cannot be used, or the device has no room.
    pub fn new(device: &Device, recording: Box<dyn Recording>, options: &SessionOptions) -> Result<Self, Error> {
        let resumed;
        let options = match &options.start {
            Start::Resume(path) => {
                let SavedSession { settings, poses, next_frame, .. } = SavedSession::open(path)?;
                let next = usize::try_from(next_frame).unwrap_or(usize::MAX);
                let frames = options.frames.clone().unwrap_or(next..recording.info().frames.max(next));
                resumed = SessionOptions { settings, poses, frames: Some(frames), start: options.start.clone() };
                &resumed
            }
            _ => options,
        };
        let range = Self::check(recording.as_ref(), options)?;
        let info = recording.info().clone();
        let settings = Self::fit(&options.settings, &info, options.poses);
        let slam = match &options.start {
            Start::Afresh => Slam::new(device, &info.calibration, &settings, options.poses)?,
            Start::Resume(path) => Slam::resume(device, path)?,
            Start::InMap { path, world_from_camera } => {
                Slam::in_map(device, &info.calibration, &settings, path, world_from_camera.as_ref())?
            }
        };
        let summary = Summary { frames: range.len(), ..Summary::default() };
        Ok(Self {
            slam,
            info,
            frames: ReadAhead::new(recording, range.clone(), ReadAhead::DEFAULT_FRAMES),
            next: range.start,
            range,
            frame: None,
            summary,
            met: BTreeMap::new(),
            started: None,
            finished: false,
            stop: Arc::default(),
        })
    }

    /// Settings without what a recording cannot fill: colours in the map, and their comparison by trackers that go without.
    pub fn fit(settings: &Settings, info: &RecordingInfo, poses: Poses) -> Settings {
        let mut settings = settings.clone();
        // A plane for colours that never come would be half the map's memory.
        settings.map.colour &= info.has_colour && settings.view.colour;
        let extended = matches!(settings.tracker.kind, TrackerKind::Extended | TrackerKind::ExtendedImu);
        if extended && poses == Poses::Tracked {
            without_colour(&mut settings, info);
        }
        settings
    }

    /// Finds out, without a device, whether a recording can be run so, and returns the frames that would be.
    ///
    /// # Errors
    /// Where the settings or the range of frames cannot be used, given poses are asked for and there are none, or the
    /// tracker needs what the recording does not have: colour, an inertial sensor's readings, a pose of each frame.
    pub fn check(recording: &dyn Recording, options: &SessionOptions) -> Result<Range<usize>, Error> {
        let info = recording.info();
        options.settings.validate()?;
        if options.poses == Poses::Given && info.ground_truth.is_none() {
            return Err(Error::NoPoses { recording: info.name.clone() });
        }
        let range = options.frames.clone().unwrap_or(0..info.frames);
        if range.is_empty() || range.end > info.frames {
            return Err(Error::NoSuchFrames {
                recording: info.name.clone(),
                first: range.start,
                last: range.end.saturating_sub(1),
                frames: info.frames,
            });
        }
        if !options.settings.map.fuse && matches!(options.start, Start::Afresh) {
            return Err(Error::NothingToTrackAgainst);
        }
        if options.poses == Poses::Tracked {
            check_tracker(recording, &options.settings, &range)?;
        }
        Ok(range)
    }

    /// What is known of the recording.
    pub fn info(&self) -> &RecordingInfo {
        &self.info
    }

    /// The core, for the trajectory and what is known of the map.
    pub fn slam(&self) -> &Slam {
        &self.slam
    }

    /// The core, without the recording.
    pub fn into_slam(self) -> Slam {
        self.slam
    }

    /// The core, for meshes and pictures too.
    pub fn slam_mut(&mut self) -> &mut Slam {
        &mut self.slam
    }

    /// The last frame that was processed.
    pub fn frame(&self) -> Option<&Frame> {
        self.frame.as_ref()
    }

    /// The frames that the run is over, by their places in the recording, and the one that comes next.
    pub fn place(&self) -> (Range<usize>, usize) {
        (self.range.clone(), self.next)
    }

    /// Goes on with another frame of the run, forwards or back: the map stays, and the camera is looked for from where it was
    /// last. What was finished, or stopped, is so no longer.
    ///
    /// # Errors
    /// Where the frame is not one of the run's.
    pub fn seek(&mut self, frame: usize) -> Result<(), Error> {
        if !self.range.contains(&frame) {
            return Err(Error::NoSuchFrames {
                recording: self.info.name.clone(),
                first: frame,
                last: frame,
                frames: self.range.end,
            });
        }
        self.frames.restart(frame..self.range.end);
        self.next = frame;
        self.finished = false;
        self.stop.store(false, Ordering::Relaxed);
        self.summary.stopped = false;
        self.slam.interrupt();
        Ok(())
    }

    /// A switch that ends the run after the current frame when set, from any thread.
    pub fn stop_switch(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// The surface of the whole map; see [`Slam::mesh`].
    ///
    /// # Errors
    /// Where the device fails.
    pub fn mesh(&mut self, progress: &mut dyn FnMut(u32, u32)) -> Result<Mesh, Error> {
        self.slam.mesh(progress)
    }

    fn skipped(&mut self, index: usize, reason: String) -> Event {
        self.meet(index, Met { skipped: true, ..Met::default() });
        Event::Skipped { index, reason }
    }

    /// Counts what became of a frame, in place of what became of it before.
    fn meet(&mut self, index: usize, met: Met) {
        let before = self.met.insert(index, met).unwrap_or_default();
        let Summary { posed, poor, lost, skipped, .. } = &mut self.summary;
        for (count, is, was) in [
            (posed, met.posed, before.posed),
            (poor, met.poor, before.poor),
            (lost, met.lost, before.lost),
            (skipped, met.skipped, before.skipped),
        ] {
            *count = *count + usize::from(is) - usize::from(was);
        }
    }

    fn finish(&mut self, error: Option<String>) -> Event {
        self.finished = true;
        // Kept: where another frame is gone on with, the run goes on.
        let mut summary = self.summary.clone();
        summary.seconds = self.started.map_or(0.0, |s| s.elapsed().as_secs_f64());
        summary.error = error;
        match self.slam.finish() {
            Ok(reports) => summary.reports = reports,
            Err(e) => summary.error = summary.error.or(Some(e.to_string())),
        }
        Event::Finished(summary)
    }
}

/// Whether the recording has what the tracker needs.
fn check_tracker(recording: &dyn Recording, settings: &Settings, range: &Range<usize>) -> Result<(), Error> {
    let tracker = &settings.tracker;
    let parts = match tracker.kind {
        TrackerKind::Composite => tracker.parts()?,
        _ => vec![tracker.clone()],
    };
    for part in &parts {
        check_part(recording.info(), settings, part)?;
        if part.kind == TrackerKind::File {
            let poses = pose_files(part)?;
            // A composite has other trackers for frames without a pose.
            if tracker.kind == TrackerKind::File {
                check_poses(recording, &poses, &part.file.mask, range)?;
            }
        }
    }
    Ok(())
}

fn check_part(info: &RecordingInfo, settings: &Settings, tracker: &TrackerSettings) -> Result<(), Error> {
    let recording = info.name.clone();
    let instead = match tracker.kind {
        TrackerKind::ImuIcp => Some("icp"),
        TrackerKind::ExtendedImu => Some("extended"),
        _ => None,
    };
    if let Some(instead) = instead.filter(|_| !info.has_gyroscope && !info.has_imu_orientation) {
        return Err(Error::NoInertialSensor { tracker: tracker.kind.name(), recording, instead });
    }
    let extended = &tracker.extended;
    // Colour of the frame before will do for one, the map's is needed for the other.
    let of_map_alone = match tracker.kind {
        TrackerKind::Rgb => true,
        TrackerKind::Extended | TrackerKind::ExtendedImu if !extended.use_depth => !extended.use_colour,
        _ => return Ok(()),
    };
    let reason = if !info.has_colour {
        format!("the recording '{recording}' has none")
    } else if !settings.view.colour {
        "view.colour is off".into()
    } else if of_map_alone && !settings.map.colour {
        "the map has none, as map.colour is off".into()
    } else {
        return Ok(());
    };
    Err(Error::NoColour { tracker: tracker.kind.name(), reason })
}

fn pose_files(tracker: &TrackerSettings) -> Result<PoseFiles, Error> {
    let mask = &tracker.file.mask;
    if mask.is_empty() {
        return Err(Error::Settings(SettingsError::Value {
            key: "tracker.file.mask",
            expected: "a mask with the frame's number, as poses/%06d.txt, or a trajectory's file",
            found: "''".into(),
        }));
    }
    Ok(PoseFiles::new("".as_ref(), mask)?)
}

fn check_poses(recording: &dyn Recording, poses: &PoseFiles, mask: &str, range: &Range<usize>) -> Result<(), Error> {
    for frame in range.clone() {
        let time = match recording.timestamp(frame) {
            Some(time) => time,
            // What the frames' times are is only known as they are read.
            None if poses.is_by_time() => return Ok(()),
            None => Timestamp(0),
        };
        if poses.read(frame as u64, time)?.is_none() {
            return Err(Error::NoPoseOfFrame { mask: mask.into(), frame });
        }
    }
    Ok(())
}

/// Switches off the comparison of colours where there are none, and says so.
fn without_colour(settings: &mut Settings, info: &RecordingInfo) {
    let Settings { view, map, tracker, .. } = settings;
    let extended = &mut tracker.extended;
    let asked = extended.use_colour || extended.use_map_colour;
    let live = info.has_colour && view.colour;
    extended.use_colour &= live;
    extended.use_map_colour &= live && map.colour;
    let left = extended.use_colour || extended.use_map_colour;
    if asked && !left {
        let why = match (info.has_colour, view.colour) {
            (false, _) => format!("the recording '{}' has no colour", info.name),
            (true, false) => "view.colour is off".into(),
            (true, true) => "map.colour is off".into(),
        };
        tracing::warn!("{why}: the tracker '{}' compares depth alone", tracker.kind.name());
    }
}

impl Iterator for Session {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        if self.finished {
            return None;
        }
        if let Some(warning) = self.slam.next_warning() {
            return Some(Event::Warning(warning));
        }
        if self.stop.load(Ordering::Relaxed) {
            self.summary.stopped = true;
            return Some(self.finish(None));
        }
        let Some(frame) = self.frames.next() else { return Some(self.finish(None)) };
        let index = self.next;
        self.next += 1;
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => return Some(self.skipped(index, error.to_string())),
        };
        let started = Instant::now();
        self.started.get_or_insert(started);
        let processed = self.slam.process(&frame);
        self.frame = Some(frame);
        match processed {
            Ok(result) => {
                self.meet(
                    index,
                    Met {
                        posed: result.world_from_camera.is_some(),
                        poor: matches!(result.status, FrameStatus::Poor { .. }),
                        lost: matches!(result.status, FrameStatus::Lost { .. }),
                        skipped: false,
                    },
                );
                Some(Event::Frame { result, total_ms: started.elapsed().as_secs_f64() * 1e3 })
            }
            Err(error @ Error::Gpu(itm_gpu::Error::ImageSize { .. })) => Some(self.skipped(index, error.to_string())),
            Err(error) => {
                // The device failed: what was done so far is kept.
                self.summary.stopped = true;
                Some(self.finish(Some(error.to_string())))
            }
        }
    }
}
