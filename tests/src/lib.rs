//! What the tests of whole runs share: recordings in memory, running them, and measuring meshes against the truth.

#![allow(clippy::print_stdout, reason = "tests say what they skip")]

pub mod surface;

use std::path::PathBuf;

use itm_io::Error as IoError;
use itm_io::recording::{Format, Recording, RecordingInfo};
use itm_slam::{
    Device, Event, Frame, FrameReport, FrameResult, Mode, Poses, Session, SessionOptions, Settings, Summary,
};
use itm_synth::{Path, Sequence, Spec};

/// A synthetic recording that is made as it is read.
#[derive(Debug)]
pub struct InMemory {
    sequence: Sequence,
    info: RecordingInfo,
}

impl InMemory {
    /// A recording of a sequence.
    pub fn new(sequence: Sequence) -> Self {
        let info = RecordingInfo {
            name: "synthetic".into(),
            format: Format::Tum,
            calibration: sequence.calibration(),
            calibration_source: "the synthetic camera".into(),
            frames: sequence.spec().frames as usize,
            depth_without_colour: 0,
            has_timestamps: true,
            has_colour: true,
            has_gyroscope: false,
            has_imu_orientation: false,
            ground_truth: Some(sequence.trajectory()),
        };
        Self { sequence, info }
    }
}

impl Recording for InMemory {
    fn info(&self) -> &RecordingInfo {
        &self.info
    }

    fn read(&mut self, index: usize) -> Result<Frame, IoError> {
        Ok(self.sequence.frame(u32::try_from(index).expect("few frames")))
    }
}

/// A recording along a path, without noise.
///
/// # Panics
/// Where there can be none of that size.
pub fn sequence(path: Path, size: (u32, u32), frames: u32) -> Sequence {
    Sequence::new(Spec::new(path).with_size(size.0, size.1).with_frames(frames)).expect("a valid specification")
}

/// Settings for small images: small voxels' worth of map.
pub fn small_map(mode: Mode) -> Settings {
    let mut settings = Settings { mode, ..Settings::default() };
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    settings
}

/// Opens the best adapter; `None`, with a word about it, where the environment variable `ITM_SKIP_GPU_TESTS` is set.
///
/// # Panics
/// Without an adapter: a test that was not run has not passed.
pub fn device() -> Option<Device> {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        println!("skipped: ITM_SKIP_GPU_TESTS is set");
        return None;
    }
    Some(Device::open("auto").expect("an adapter, or ITM_SKIP_GPU_TESTS set"))
}

/// A folder of real recordings; `None`, with a word about it, where `ITM_TEST_DATA` is not set.
pub fn real_recording(name: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("ITM_TEST_DATA") else {
        println!("skipped: ITM_TEST_DATA is not set");
        return None;
    };
    Some(PathBuf::from(folder).join(name))
}

/// A finished run.
#[derive(Debug)]
pub struct Run {
    /// The session, for its map and trajectory.
    pub session: Session,
    /// What became of each frame that could be read.
    pub frames: Vec<FrameResult>,
    /// The end.
    pub summary: Summary,
}

impl Run {
    /// All that became known of frames, in order.
    pub fn reports(&self) -> impl Iterator<Item = &FrameReport> {
        self.frames.iter().filter_map(|f| f.report.as_ref()).chain(&self.summary.reports)
    }
}

/// Runs a recording to its end.
///
/// # Panics
/// Where the run cannot be prepared.
pub fn run(device: &Device, recording: Box<dyn Recording>, settings: &Settings, poses: Poses) -> Run {
    let options = SessionOptions { settings: settings.clone(), poses, frames: None, start: itm_slam::Start::Afresh };
    let mut session = Session::new(device, recording, &options).expect("a recording that can be run");
    let mut frames = Vec::new();
    let mut summary = None;
    for event in session.by_ref() {
        match event {
            Event::Frame { result, .. } => frames.push(result),
            Event::Finished(end) => summary = Some(end),
            _ => {}
        }
    }
    Run { session, frames, summary: summary.expect("every run finishes") }
}
