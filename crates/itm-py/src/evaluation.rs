//! How far a trajectory is from the truth.

use itm_core::evaluation::{self as core, ErrorStatistics as Statistics};
use numpy::PyArray2;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{arrays, errors, trajectory};

/// What a set of errors looks like; all in the unit of the errors.
#[pyclass(module = "itm_slam", frozen, get_all)]
pub(crate) struct ErrorStatistics {
    /// Root of the mean square.
    rmse: f64,
    /// Arithmetic mean.
    mean: f64,
    /// The middle value.
    median: f64,
    /// Standard deviation about the mean.
    std: f64,
    /// Smallest.
    min: f64,
    /// Largest.
    max: f64,
}

impl From<Statistics> for ErrorStatistics {
    fn from(Statistics { rmse, mean, median, std, min, max }: Statistics) -> Self {
        Self { rmse, mean, median, std, min, max }
    }
}

#[pymethods]
impl ErrorStatistics {
    fn __repr__(&self) -> String {
        let Self { rmse, mean, median, std, min, max } = self;
        format!("ErrorStatistics(rmse={rmse}, mean={mean}, median={median}, std={std}, min={min}, max={max})")
    }
}

/// How far a trajectory is from the truth; as a string a small table.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Evaluation(core::Evaluation);

#[pymethods]
impl Evaluation {
    /// Estimated poses that have a true one; the errors are over these alone.
    #[getter]
    fn pairs(&self) -> usize {
        self.0.pairs
    }

    /// Poses of the estimate.
    #[getter]
    fn estimate_poses(&self) -> usize {
        self.0.estimate_poses
    }

    /// Poses of the ground truth.
    #[getter]
    fn truth_poses(&self) -> usize {
        self.0.truth_poses
    }

    /// Length in metres of the true path through the paired poses.
    #[getter]
    fn path_length_m(&self) -> f64 {
        self.0.path_length_m
    }

    /// Absolute trajectory error in metres, after alignment by a rigid motion.
    #[getter]
    fn ate(&self) -> ErrorStatistics {
        self.0.ate.into()
    }

    /// Translational part of the relative pose error in metres, from each pair to the next.
    #[getter]
    fn rpe_translation(&self) -> ErrorStatistics {
        self.0.rpe_translation.into()
    }

    /// Rotational part of it, in radians.
    #[getter]
    fn rpe_rotation(&self) -> ErrorStatistics {
        self.0.rpe_rotation.into()
    }

    /// The alignment behind the absolute error, 4x4 float64.
    #[getter]
    fn truth_from_estimate<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, &self.0.truth_from_estimate)
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        format!("<Evaluation of {} pairs, ATE {:.2} mm rmse>", self.0.pairs, self.0.ate.rmse * 1e3)
    }
}

/// Compares an estimated trajectory with the true one (Sturm et al. 2012), whose worlds may differ by a rigid motion. Each is a
/// Trajectory, the path of a file in TUM's format, or timestamps and poses. Poses are paired with the nearest in time, up to
/// tolerance_ms milliseconds apart.
#[pyfunction]
#[pyo3(signature = (estimate, truth, tolerance_ms=20.0))]
pub(crate) fn evaluate(
    py: Python<'_>,
    estimate: &Bound<'_, PyAny>,
    truth: &Bound<'_, PyAny>,
    tolerance_ms: f64,
) -> PyResult<Evaluation> {
    if !(0.0..=1e9).contains(&tolerance_ms) {
        return Err(PyValueError::new_err(format!("tolerance_ms must be between 0 and 1e9, not {tolerance_ms}")));
    }
    let (estimate, truth) = (trajectory::of(estimate, "estimate")?, trajectory::of(truth, "ground truth")?);
    let tolerance_ns = (tolerance_ms * 1e6).round() as i64;
    let evaluated = py.detach(|| core::evaluate(&estimate, &truth, tolerance_ns));
    evaluated.map(Evaluation).map_err(|error| errors::trajectory(error.to_string()))
}
