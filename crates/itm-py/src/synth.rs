//! Synthetic recordings.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::str::FromStr as _;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use itm_io::recording::OpenOptions;
use itm_synth::{DepthNoise, Error, InertialNoise, Path, Quality, SceneName, Spec};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::calibration::{Calibration, Intrinsics};
use crate::errors;
use crate::frame::Frame;
use crate::interrupt::watched;
use crate::recording::{Recording, place};
use crate::trajectory::Trajectory;

/// A synthetic recording of furnished rooms with exact poses: written to a folder, which is then opened, or made as it is
/// read where no folder is given.
///
/// path is how the camera moves: 'arc', 'loop', 'shake', 'covered', 'fast', 'wall', 'hall', 'corridor', 'eight', 'rooms' or
/// 'kidnapped'. size is (width, height) in pixels, or camera says all of it. noise is 'kinect' or 'off', quality 'draft' or
/// 'fine'. The same arguments give the same bytes.
#[pyfunction]
#[pyo3(signature = (
    folder=None, *, path="arc", scene=None, frames=None, size=(640, 480), camera=None, duration_s=None, noise="kinect",
    colour=true, seed=0, there_and_back=false, quality="draft",
))]
#[expect(clippy::too_many_arguments, reason = "Python names them")]
pub(crate) fn synth<'py>(
    py: Python<'py>,
    folder: Option<PathBuf>,
    path: &str,
    scene: Option<&str>,
    frames: Option<u32>,
    size: (u32, u32),
    camera: Option<&Intrinsics>,
    duration_s: Option<f64>,
    noise: &str,
    colour: bool,
    seed: u64,
    there_and_back: bool,
    quality: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let mut spec = Spec::new(Path::from_str(path).map_err(of_synth)?).with_size(size.0.max(1), size.1.max(1));
    if size.0 == 0 || size.1 == 0 {
        return Err(PyValueError::new_err(format!("size must be (width, height), both above 0, not {size:?}")));
    }
    if let Some(camera) = camera {
        spec.camera = camera.0;
    }
    if let Some(duration_s) = duration_s {
        spec.duration_s = duration_s;
        spec.frames = (duration_s * spec.frame_rate_hz).round() as u32;
    }
    spec.frames = frames.unwrap_or(spec.frames);
    if spec.frames == 0 {
        return Err(PyValueError::new_err("frames must be at least 1, not 0"));
    }
    if there_and_back {
        spec = spec.there_and_back();
    }
    if let Some(scene) = scene {
        spec.scene = SceneName::from_str(scene).map_err(of_synth)?;
    }
    (spec.noise, spec.inertial_noise) = match noise {
        "kinect" => (Some(DepthNoise::KINECT), Some(InertialNoise::PHONE)),
        "off" => (None, None),
        other => return Err(PyValueError::new_err(format!("noise must be 'kinect' or 'off', not '{other}'"))),
    };
    spec.quality = match quality {
        "draft" => Quality::Draft,
        "fine" => Quality::Fine,
        other => return Err(PyValueError::new_err(format!("quality must be 'draft' or 'fine', not '{other}'"))),
    };
    (spec.colour, spec.seed) = (colour, seed);
    let sequence = itm_synth::Sequence::new(spec).map_err(of_synth)?;
    let Some(folder) = folder else {
        return Ok(Bound::new(py, Sequence(sequence))?.into_any());
    };
    let write = |stopping: &AtomicBool| {
        let told =
            |_| if stopping.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        itm_synth::write_recording_until(&folder, &sequence, &told)
    };
    let _written = watched(py, write)?.map_err(of_synth)?;
    Ok(Bound::new(py, Recording::open(py, folder, OpenOptions::default())?)?.into_any())
}

fn of_synth(error: Error) -> PyErr {
    match error {
        Error::Camera(error) => errors::calibration(error.to_string()),
        Error::Write { .. } | Error::WriteImage { .. } => errors::recording(error.to_string()),
        _ => PyValueError::new_err(error.to_string()),
    }
}

/// A synthetic recording that is made as it is read. Depth is in metres, with all its digits.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Sequence(pub(crate) itm_synth::Sequence);

#[pymethods]
impl Sequence {
    /// Its cameras, of depth and colour alike.
    #[getter]
    fn calibration(&self) -> Calibration {
        Calibration(self.0.calibration())
    }

    /// Exact poses of all frames.
    #[getter]
    fn ground_truth(&self) -> Trajectory {
        Trajectory(self.0.trajectory())
    }

    fn __len__(&self) -> usize {
        self.0.spec().frames as usize
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Frame> {
        let index = place(index, self.0.spec().frames as usize)?;
        let frame = py.detach(|| self.0.frame(u32::try_from(index).unwrap_or(u32::MAX)));
        Ok(Frame::new(frame, self.0.calibration()))
    }

    fn __iter__(this: Bound<'_, Self>) -> SequenceFrames {
        SequenceFrames { sequence: this.unbind(), next: AtomicU32::new(0) }
    }

    fn __repr__(&self) -> String {
        let spec = self.0.spec();
        format!("<Sequence of {} frames in '{}'>", spec.frames, spec.scene.name())
    }
}

/// An iterator over a sequence's frames.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct SequenceFrames {
    sequence: Py<Sequence>,
    next: AtomicU32,
}

#[pymethods]
impl SequenceFrames {
    fn __iter__(this: Bound<'_, Self>) -> Bound<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Frame>> {
        let sequence = self.sequence.get();
        let next = self.next.fetch_add(1, Ordering::Relaxed);
        (next < sequence.0.spec().frames).then(|| sequence.__getitem__(py, next as isize)).transpose()
    }
}
