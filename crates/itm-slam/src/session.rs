//! Running over a recording as a stream of events.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use itm_core::{Mesh, Settings};
use itm_io::recording::{ReadAhead, Recording, RecordingInfo};

use crate::{Device, Error, FrameReport, FrameResult, FrameStatus, Poses, Slam};

/// How a recording is run.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// Settings.
    pub settings: Settings,
    /// Where poses come from.
    pub poses: Poses,
    /// Which frames, by their place in the recording; `None` for all.
    pub frames: Option<Range<usize>>,
}

/// What happens in a run, in order.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "an event is moved once, and nearly all of them are frames")]
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
    /// No more frames come. Sent once, last.
    Finished(Summary),
}

/// A run in numbers.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Frames that were asked for.
    pub frames: usize,
    /// Frames with a pose.
    pub posed: usize,
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

/// A run over a recording: an iterator over its events. Frames are decoded ahead on another thread.
pub struct Session {
    slam: Slam,
    info: RecordingInfo,
    frames: ReadAhead,
    first: usize,
    taken: usize,
    summary: Summary,
    started: Option<Instant>,
    finished: bool,
    stop: Arc<AtomicBool>,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session")
            .field("recording", &self.info.name)
            .field("taken", &self.taken)
            .finish_non_exhaustive()
    }
}

impl Session {
    /// Prepares a run; nothing is processed before the first event is asked for.
    ///
    /// # Errors
    /// Where the settings, the calibration or the range of frames cannot be used, given poses are asked for and there are
    /// none, or the device has no room.
    pub fn new(device: &Device, recording: Box<dyn Recording>, options: &SessionOptions) -> Result<Self, Error> {
        let info = recording.info().clone();
        if options.poses == Poses::Given && info.ground_truth.is_none() {
            return Err(Error::NoPoses { recording: info.name });
        }
        let range = options.frames.clone().unwrap_or(0..info.frames);
        if range.is_empty() || range.end > info.frames {
            return Err(Error::NoSuchFrames {
                recording: info.name,
                first: range.start,
                last: range.end.saturating_sub(1),
                frames: info.frames,
            });
        }
        let mut settings = options.settings.clone();
        // A plane for colours that never come would be half the map's memory.
        settings.map.colour &= info.has_colour;
        let slam = Slam::new(device, &info.calibration, &settings, options.poses)?;
        let summary = Summary { frames: range.len(), ..Summary::default() };
        Ok(Self {
            slam,
            info,
            first: range.start,
            frames: ReadAhead::new(recording, range, ReadAhead::DEFAULT_FRAMES),
            taken: 0,
            summary,
            started: None,
            finished: false,
            stop: Arc::default(),
        })
    }

    /// What is known of the recording.
    pub fn info(&self) -> &RecordingInfo {
        &self.info
    }

    /// The core, for meshes, pictures and the trajectory.
    pub fn slam(&mut self) -> &mut Slam {
        &mut self.slam
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

    fn finish(&mut self, error: Option<String>) -> Event {
        self.finished = true;
        let mut summary = std::mem::take(&mut self.summary);
        summary.seconds = self.started.map_or(0.0, |s| s.elapsed().as_secs_f64());
        summary.error = error;
        match self.slam.finish() {
            Ok(reports) => summary.reports = reports,
            Err(e) => summary.error = summary.error.or(Some(e.to_string())),
        }
        Event::Finished(summary)
    }
}

impl Iterator for Session {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        if self.finished {
            return None;
        }
        if self.stop.load(Ordering::Relaxed) {
            self.summary.stopped = true;
            return Some(self.finish(None));
        }
        let Some(frame) = self.frames.next() else { return Some(self.finish(None)) };
        let index = self.first + self.taken;
        self.taken += 1;
        let skipped = |summary: &mut Summary, reason: String| {
            summary.skipped += 1;
            Some(Event::Skipped { index, reason })
        };
        let frame = match frame {
            Ok(frame) => frame,
            Err(error) => return skipped(&mut self.summary, error.to_string()),
        };
        let started = Instant::now();
        self.started.get_or_insert(started);
        match self.slam.process(&frame) {
            Ok(result) => {
                self.summary.posed += usize::from(result.world_from_camera.is_some());
                self.summary.lost += usize::from(matches!(result.status, FrameStatus::Lost { .. }));
                Some(Event::Frame { result, total_ms: started.elapsed().as_secs_f64() * 1e3 })
            }
            Err(error @ Error::Gpu(itm_gpu::Error::ImageSize { .. })) => skipped(&mut self.summary, error.to_string()),
            Err(error) => {
                // The device failed: what was done so far is kept.
                self.summary.stopped = true;
                Some(self.finish(Some(error.to_string())))
            }
        }
    }
}
