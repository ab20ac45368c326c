//! Recordings, frame by frame.

use std::path::PathBuf;
use std::str::FromStr as _;
use std::sync::{Mutex, PoisonError};

use itm_io::recording::{self as files, Format, OpenOptions, ReadAhead, RecordingInfo, Topics};
use pyo3::exceptions::{PyIndexError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyMapping;

use crate::arrays::describe;
use crate::calibration::Calibration;
use crate::errors;
use crate::frame::Frame;
use crate::trajectory::Trajectory;

/// Opens a recording: a folder in the format of TUM RGB-D, ICL-NUIM or 7-Scenes, an MCAP file, or images with a calibration
/// file. Images are decoded as they are asked for.
#[pyfunction]
#[pyo3(signature = (
    path, *, format=None, calibration=None, depth_pattern=None, colour_pattern=None, imu_pattern=None, topics=None,
))]
#[expect(clippy::too_many_arguments, reason = "Python names them")]
pub(crate) fn open(
    py: Python<'_>,
    path: PathBuf,
    format: Option<&str>,
    calibration: Option<PathBuf>,
    depth_pattern: Option<String>,
    colour_pattern: Option<String>,
    imu_pattern: Option<String>,
    topics: Option<&Bound<'_, PyAny>>,
) -> PyResult<Recording> {
    let format = format.map(Format::from_str).transpose().map_err(|error| PyValueError::new_err(error.to_string()))?;
    let topics = topics.map(topics_of).transpose()?.unwrap_or_default();
    let options = OpenOptions { format, calibration, depth_pattern, colour_pattern, imu_pattern, topics };
    Recording::open(py, path, options)
}

/// Topics from `{"depth": "/camera/depth"}`, or from the program's `depth=/camera/depth`.
fn topics_of(given: &Bound<'_, PyAny>) -> PyResult<Topics> {
    let text = if let Ok(mapping) = given.cast::<PyMapping>() {
        let pair = |item: Bound<'_, PyAny>| {
            let (key, value): (String, String) = item.extract()?;
            Ok(format!("{key}={value}"))
        };
        mapping.items()?.iter().map(pair).collect::<PyResult<Vec<_>>>()?.join(",")
    } else if let Ok(text) = given.extract::<String>() {
        text
    } else {
        return Err(PyTypeError::new_err(format!("topics must be a dict or a string, not {}", describe(given))));
    };
    Topics::from_str(&text).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// A recording: a sequence of frames, with what is known of its cameras. Iterating decodes ahead on another thread.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Recording {
    path: PathBuf,
    options: OpenOptions,
    pub(crate) info: RecordingInfo,
    frames: Mutex<Box<dyn files::Recording>>,
}

impl Recording {
    pub(crate) fn open(py: Python<'_>, path: PathBuf, options: OpenOptions) -> PyResult<Self> {
        let opened = py.detach(|| files::open(&path, &options));
        let recording = opened.map_err(|error| errors::of_io(&error, errors::recording))?;
        let info = recording.info().clone();
        Ok(Self { path, options, info, frames: Mutex::new(recording) })
    }

    /// Does something with the recording, to which one thread has access at a time.
    pub(crate) fn with<T>(&self, what: impl FnOnce(&mut dyn files::Recording) -> T) -> T {
        what(self.frames.lock().unwrap_or_else(PoisonError::into_inner).as_mut())
    }
}

#[pymethods]
impl Recording {
    /// The folder's name, or the file's without its ending.
    #[getter]
    fn name(&self) -> &str {
        &self.info.name
    }

    /// 'tum', 'icl-nuim', '7-scenes', 'mcap' or 'images'.
    #[getter]
    fn format(&self) -> &'static str {
        self.info.format.name()
    }

    /// Its cameras.
    #[getter]
    fn calibration(&self) -> Calibration {
        Calibration(self.info.calibration)
    }

    /// Where the calibration came from, in words.
    #[getter]
    fn calibration_source(&self) -> &str {
        &self.info.calibration_source
    }

    /// Whether there are colour images.
    #[getter]
    fn has_colour(&self) -> bool {
        self.info.has_colour
    }

    /// Whether frames have times of their own; otherwise they count as taken 30 times a second.
    #[getter]
    fn has_timestamps(&self) -> bool {
        self.info.has_timestamps
    }

    /// Whether there are a gyroscope's readings.
    #[getter]
    fn has_gyroscope(&self) -> bool {
        self.info.has_gyroscope
    }

    /// All true poses of the depth camera that the recording has; None without any.
    #[getter]
    fn ground_truth(&self) -> Option<Trajectory> {
        self.info.ground_truth.clone().map(Trajectory)
    }

    fn __len__(&self) -> usize {
        self.info.frames
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Frame> {
        let index = place(index, self.info.frames)?;
        let read = py.detach(|| self.with(|recording| recording.read(index)));
        let frame = read.map_err(|error| errors::of_io(&error, errors::recording))?;
        Ok(Frame::new(frame, self.info.calibration))
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<Frames> {
        self.frames(py, 0, None, false)
    }

    /// The frames from start on, up to stop, which is not included. One that cannot be read raises RecordingError, after which
    /// the iterator goes on with the next; with skip_unreadable it is left out and named in the iterator's skipped.
    #[pyo3(signature = (start=0, stop=None, *, skip_unreadable=false))]
    fn frames(&self, py: Python<'_>, start: usize, stop: Option<usize>, skip_unreadable: bool) -> PyResult<Frames> {
        let stop = stop.unwrap_or(self.info.frames);
        if start > stop || stop > self.info.frames {
            return Err(PyIndexError::new_err(format!(
                "frames {start} to {stop} were asked for, but the recording '{}' has {}",
                self.info.name, self.info.frames
            )));
        }
        // Opened anew, so that iterators are independent of each other.
        let opened = py.detach(|| files::open(&self.path, &self.options));
        let recording = opened.map_err(|error| errors::of_io(&error, errors::recording))?;
        Ok(Frames {
            ahead: Mutex::new(ReadAhead::new(recording, start..stop, ReadAhead::DEFAULT_FRAMES)),
            calibration: self.info.calibration,
            skip_unreadable,
            skipped: Mutex::default(),
        })
    }

    fn __repr__(&self) -> String {
        format!("<Recording '{}' ({}) of {} frames>", self.info.name, self.info.format, self.info.frames)
    }
}

/// The place of a frame that Python counts from either end.
pub(crate) fn place(index: isize, frames: usize) -> PyResult<usize> {
    let from_start = if index < 0 { index.checked_add_unsigned(frames) } else { Some(index) };
    let place = from_start.and_then(|place| usize::try_from(place).ok()).filter(|&place| place < frames);
    place.ok_or_else(|| PyIndexError::new_err(format!("frame {index} was asked for, but there are {frames}")))
}

/// An iterator over frames, which are decoded ahead on another thread.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Frames {
    ahead: Mutex<ReadAhead>,
    calibration: itm_core::Calibration,
    skip_unreadable: bool,
    skipped: Mutex<Vec<String>>,
}

#[pymethods]
impl Frames {
    fn __iter__(this: Bound<'_, Self>) -> Bound<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Frame>> {
        loop {
            let next = py.detach(|| self.ahead.lock().unwrap_or_else(PoisonError::into_inner).next());
            match next {
                None => return Ok(None),
                Some(Ok(frame)) => return Ok(Some(Frame::new(frame, self.calibration))),
                Some(Err(error)) if self.skip_unreadable => {
                    self.skipped.lock().unwrap_or_else(PoisonError::into_inner).push(error.to_string());
                    py.check_signals()?;
                }
                Some(Err(error)) => return Err(errors::of_io(&error, errors::recording)),
            }
        }
    }

    /// Which frames were left out so far, and why.
    #[getter]
    fn skipped(&self) -> Vec<String> {
        self.skipped.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
