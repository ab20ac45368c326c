//! What is written, and said, as a session goes on.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::{Context as _, Error, Result, bail};
use indicatif::ProgressBar;
use itm_core::{Settings, StampedPose, Trajectory};
use itm_io::recording::RecordingInfo;
use itm_io::trajectory::{TimeColumn, TumWriter};
use itm_slam::{Event, FrameReport, FrameResult, FrameStatus, Happening, Notice, Session};

use crate::console;
use crate::summary::Message;
use crate::timings::Timings;

/// Follows a session's events: what they say goes into files, onto the progress bar and into messages.
pub(crate) struct Log {
    trajectory: TumWriter,
    /// Whether that file was written anew, so that it is not the live trajectory any more.
    pub(crate) rewritten: bool,
    /// The settings that were written.
    settings: Settings,
    pub(crate) timings: Timings<BufWriter<File>>,
    info: RecordingInfo,
    pub(crate) messages: Vec<Message>,
    /// Why results could not be written any more.
    pub(crate) failure: Option<Error>,
    /// Whether each frame that was not good is told.
    pub(crate) explain: bool,
    lost: bool,
    full: bool,
    dropped: bool,
    unstored: bool,
    /// When the latest frames were done.
    done: VecDeque<Instant>,
    blocks: u32,
    /// Surfels, where the map is one of them.
    surfels: Option<u32>,
}

/// Frames that the frame rate shown is an average over.
const RATE_OVER: usize = 30;

impl Log {
    /// Creates the files that grow with the run, and writes the settings.
    ///
    /// The frames' poses and times are flushed as they come.
    pub(crate) fn create(out: &Path, info: &RecordingInfo, settings: &Settings) -> Result<Self> {
        let at = |name: &str| out.join(name);
        let failed = |path: &Path| format!("cannot write '{}'", path.display());
        let path = at("settings.toml");
        fs::write(&path, settings.to_toml()).with_context(|| failed(&path))?;
        let time = if info.has_timestamps { TimeColumn::Seconds } else { TimeColumn::FrameNumber };
        let trajectory = TumWriter::create(&at("trajectory.txt"), time)?;
        let path = at("timings.csv");
        let file = File::create(&path).with_context(|| failed(&path))?;
        Ok(Self {
            trajectory,
            rewritten: false,
            settings: settings.clone(),
            timings: Timings::new(BufWriter::new(file)).with_context(|| failed(&path))?,
            info: info.clone(),
            messages: Vec::new(),
            failure: None,
            explain: false,
            lost: false,
            full: false,
            dropped: false,
            unstored: false,
            done: VecDeque::new(),
            blocks: 0,
            surfels: None,
        })
    }

    /// Writes the settings again where they were changed while it ran: those that hold now, and that they are not those of all
    /// frames.
    pub(crate) fn write_changed_settings(&mut self, out: &Path, settings: &Settings) -> Result<()> {
        if *settings == self.settings {
            return Ok(());
        }
        self.settings = settings.clone();
        let path = out.join("settings.toml");
        let text = format!(
            "# These were changed while it ran: they hold for the last frames, and a run with them is another one.\n{}",
            settings.to_toml()
        );
        fs::write(&path, text).with_context(|| format!("cannot write '{}'", path.display()))?;
        self.say(self.last_frame(), "settings were changed while it ran; settings.toml has the last ones".into());
        Ok(())
    }

    /// Writes the poses of a session that goes on, so that the file holds all of them.
    pub(crate) fn write_poses_before(&mut self, before: &Trajectory) -> Result<()> {
        for (pose, place) in before.poses().iter().zip(0..) {
            let number = self.info.image_number(pose.timestamp).unwrap_or(place);
            self.trajectory.write(number, pose)?;
        }
        Ok(())
    }

    /// Writes the trajectory with the submaps where they lie at the end in place of the live one, which is kept beside it.
    pub(crate) fn write_corrected(&mut self, out: &Path, trajectory: &Trajectory) -> Result<()> {
        let (path, live) = (out.join("trajectory.txt"), out.join("trajectory_live.txt"));
        fs::rename(&path, &live).with_context(|| format!("cannot keep '{}'", live.display()))?;
        self.write_trajectory(&path, trajectory)
    }

    /// Writes a trajectory anew; frames that come later follow it, where the file is the one that grows.
    pub(crate) fn write_trajectory(&mut self, path: &Path, trajectory: &Trajectory) -> Result<()> {
        let time = if self.info.has_timestamps { TimeColumn::Seconds } else { TimeColumn::FrameNumber };
        let mut writer = TumWriter::create(path, time)?;
        for (pose, place) in trajectory.poses().iter().zip(0..) {
            writer.write(self.info.image_number(pose.timestamp).unwrap_or(place), pose)?;
        }
        (self.trajectory, self.rewritten) = (writer, true);
        Ok(())
    }

    /// Runs the session to its end. Where results cannot be written any more, it is stopped, and `failure` says why.
    pub(crate) fn follow(&mut self, session: &mut Session, bar: &ProgressBar) -> Result<itm_slam::Summary> {
        let stop = session.stop_switch();
        while let Some(event) = session.next() {
            let kept = self.take(&event);
            match event {
                Event::Frame { result, .. } => {
                    bar.set_message(self.state(&result, session.slam().capacity()));
                    bar.inc(1);
                }
                Event::Skipped { .. } => bar.inc(1),
                Event::Finished(summary) => return Ok(summary),
                _ => {}
            }
            if let Err(error) = kept
                && self.failure.is_none()
            {
                self.failure = Some(error);
                stop.store(true, Ordering::Relaxed);
            }
        }
        bail!("the run ended without a summary")
    }

    /// Takes in an event: files grow, and what a user should know is told.
    pub(crate) fn take(&mut self, event: &Event) -> Result<()> {
        match event {
            Event::Frame { result, total_ms } => self.frame(result, *total_ms),
            Event::Skipped { index, reason } => {
                // The reason may name the frame already.
                let reason = reason.strip_prefix(&format!("frame {index}: ")).unwrap_or(reason);
                self.say(*index as u64, format!("skipped: {reason}"));
                self.timings.skipped(*index, reason).context("cannot write timings.csv")
            }
            Event::Warning(warning) => {
                // It was logged.
                self.messages.push(Message { frame: self.last_frame(), text: warning.to_string() });
                Ok(())
            }
            Event::Finished(summary) => {
                summary.reports.iter().for_each(|report| self.tell_notices(report));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn frame(&mut self, result: &FrameResult, total_ms: f64) -> Result<()> {
        // Both are tried: a frame whose pose could not be written still counts.
        let posed = self.pose(result);
        let timed = self.timings.frame(result, total_ms).context("cannot write timings.csv");
        self.tell(result);
        posed.and(timed)
    }

    fn pose(&mut self, result: &FrameResult) -> Result<()> {
        let Some(world_from_camera) = result.world_from_camera else { return Ok(()) };
        // Where there are no times, the number that the recording's own files and ground truth count by.
        let number = self.info.image_number(result.timestamp).unwrap_or(result.index);
        Ok(self.trajectory.write(number, &StampedPose { timestamp: result.timestamp, world_from_camera })?)
    }

    /// Tells what is new about the state of tracking and of the map.
    fn tell(&mut self, result: &FrameResult) {
        let news = match (&result.status, self.lost) {
            (FrameStatus::Lost { reason }, false) => {
                self.lost = true;
                Some(format!("tracking lost: {reason}"))
            }
            (FrameStatus::Tracked, true) => {
                self.lost = false;
                Some("tracked again".into())
            }
            _ => None,
        };
        match news {
            // Each frame is explained instead, which says as much.
            Some(text) if self.explain => self.messages.push(Message { frame: result.index, text }),
            Some(text) => self.say(result.index, text),
            None => {}
        }
        if self.explain
            && let Some(row) = self.timings.rows().last()
            && let Some(trouble) = row.trouble()
        {
            console::note(format_args!("frame {}: {trouble}: {}", row.frame, row.why()));
        }
        for happening in &result.happenings {
            match happening {
                Happening::Keyframe { .. } => {}
                _ => self.say(result.index, happening.to_string()),
            }
        }
        if let Some(report) = &result.report {
            self.tell_notices(report);
        }
    }

    /// A full map says so each frame; once is enough.
    fn tell_notices(&mut self, report: &FrameReport) {
        let mut full = false;
        for notice in &report.notices {
            let known = match notice {
                Notice::Waiting { .. } => {
                    full = true;
                    self.full
                }
                Notice::Dropped { .. } | Notice::SurfelsDropped { .. } => std::mem::replace(&mut self.dropped, true),
                Notice::HostStore { .. } => std::mem::replace(&mut self.unstored, true),
                _ => false,
            };
            if !known {
                self.say(report.index, notice.to_string());
            }
        }
        self.full = full;
    }

    pub(crate) fn say(&mut self, frame: u64, text: String) {
        console::note(format_args!("frame {frame}: {text}"));
        self.messages.push(Message { frame, text });
    }

    pub(crate) fn last_frame(&self) -> u64 {
        self.timings.rows().last().map_or(0, |row| row.frame)
    }

    /// Frame rate, state of tracking and use of blocks, for the progress bar.
    fn state(&mut self, result: &FrameResult, capacity: u32) -> String {
        let now = Instant::now();
        self.done.push_back(now);
        if self.done.len() > RATE_OVER {
            self.done.pop_front();
        }
        let seconds = self.done.front().map_or(0.0, |first| (now - *first).as_secs_f64());
        let rate = (self.done.len() - 1) as f64 / seconds.max(1e-9);
        if let Some(report) = &result.report {
            self.blocks = report.record.blocks.saturating_sub(report.record.free_blocks);
            self.surfels = report.surfels.map(|record| record.used.saturating_sub(record.free));
        }
        let status = match &result.status {
            FrameStatus::Placed => "placed",
            FrameStatus::Tracked => "tracked",
            FrameStatus::Poor { .. } => "poor",
            FrameStatus::Lost { .. } => "LOST",
            FrameStatus::NoPose => "no pose",
            FrameStatus::NoDepth => "no depth",
        };
        let size = match self.surfels {
            Some(surfels) => format!("{surfels} surfels"),
            None => format!("{} of {capacity} blocks", self.blocks),
        };
        format!("· {rate:.1} frames/s · {status} · {size}")
    }
}
