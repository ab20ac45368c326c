//! Trajectories.

use std::path::PathBuf;

use itm_core::StampedPose;
use itm_io::trajectory::{TimeColumn, TumWriter, read_tum};
use numpy::{PyArray1, PyArray3};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays;
use crate::errors;

/// Camera poses in the order of their times.
#[pyclass(module = "itm_slam", frozen, eq)]
#[derive(PartialEq)]
pub(crate) struct Trajectory(pub(crate) itm_core::Trajectory);

#[pymethods]
impl Trajectory {
    #[new]
    fn new(timestamps: &Bound<'_, PyAny>, poses: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (times, poses) = (arrays::timestamps(timestamps)?, arrays::poses(poses, "poses")?);
        if times.len() != poses.len() {
            let (times, poses) = (times.len(), poses.len());
            return Err(PyValueError::new_err(format!("{times} timestamps do not go with {poses} poses")));
        }
        let stamped = times.into_iter().zip(poses);
        Ok(Self(stamped.map(|(timestamp, world_from_camera)| StampedPose { timestamp, world_from_camera }).collect()))
    }

    /// Reads a file in the format of the TUM RGB-D benchmark: rows of time (s), position (m), quaternion.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        read_tum(&path).map(Self).map_err(|error| errors::of_io(&error, errors::trajectory))
    }

    /// Writes such a file.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let failed = |error: itm_io::Error| errors::of_io(&error, errors::trajectory);
        let mut writer = TumWriter::create(&path, TimeColumn::Seconds).map_err(failed)?;
        let mut poses = self.0.poses().iter().zip(0..);
        poses.try_for_each(|(pose, number)| writer.write(number, pose)).map_err(failed)
    }

    /// Times in nanoseconds, N int64.
    #[getter]
    fn timestamps<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        arrays::row(py, self.0.poses().iter().map(|pose| pose.timestamp.0).collect())
    }

    /// Times in seconds, N float64.
    #[getter]
    fn seconds<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::row(py, self.0.poses().iter().map(|pose| pose.timestamp.as_secs_f64()).collect())
    }

    /// Poses of the depth camera, world_from_camera, Nx4x4 float64, metres.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f64>>> {
        arrays::matrices(py, self.0.poses().iter().map(|pose| pose.world_from_camera))
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __repr__(&self) -> String {
        match self.0.poses() {
            [first, .., last] => {
                format!("<Trajectory of {} poses from {} to {} s>", self.0.len(), first.timestamp, last.timestamp)
            }
            poses => format!("<Trajectory of {} poses>", poses.len()),
        }
    }
}

/// A trajectory from what is one: itself, a file's path, a recording's or sequence's ground truth, or timestamps and poses.
pub(crate) fn of(value: &Bound<'_, PyAny>, name: &str) -> PyResult<itm_core::Trajectory> {
    if let Ok(trajectory) = value.cast::<Trajectory>() {
        return Ok(trajectory.get().0.clone());
    }
    if let Ok(pair) = value.cast::<PyTuple>()
        && pair.len() == 2
    {
        return Ok(Trajectory::new(&pair.get_item(0)?, &pair.get_item(1)?)?.0);
    }
    if let Ok(path) = value.extract::<PathBuf>() {
        return Ok(Trajectory::load(path)?.0);
    }
    let found = arrays::describe(value);
    Err(PyTypeError::new_err(format!(
        "the {name} must be a Trajectory, the path of a file in TUM's format, or (timestamps, poses), not {found}"
    )))
}
