//! Frames of recordings.

use itm_core::DepthImage;
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

use crate::arrays;

/// What a camera delivered at one moment. Arrays are made when first asked for, and cannot be written to.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Frame {
    pub(crate) frame: itm_core::Frame,
    pub(crate) calibration: itm_core::Calibration,
    depth: PyOnceLock<Py<PyArray2<f32>>>,
    raw_depth: PyOnceLock<Py<PyArray2<u16>>>,
    colour: PyOnceLock<Py<PyArray3<u8>>>,
}

impl Frame {
    pub(crate) fn new(frame: itm_core::Frame, calibration: itm_core::Calibration) -> Self {
        let (depth, raw_depth, colour) = (PyOnceLock::new(), PyOnceLock::new(), PyOnceLock::new());
        Self { frame, calibration, depth, raw_depth, colour }
    }
}

#[pymethods]
impl Frame {
    /// Number of the frame within its recording, from 0.
    #[getter]
    fn index(&self) -> u64 {
        self.frame.index
    }

    /// When it was taken, in nanoseconds.
    #[getter]
    fn timestamp(&self) -> i64 {
        self.frame.timestamp.0
    }

    /// When it was taken, in seconds.
    #[getter]
    fn seconds(&self) -> f64 {
        self.frame.timestamp.as_secs_f64()
    }

    /// When the colour image was taken, in nanoseconds; None where the recording does not say.
    #[getter]
    fn colour_timestamp(&self) -> Option<i64> {
        self.frame.colour_timestamp.map(|time| time.0)
    }

    /// Depth along the optical axis in metres, HxW float32; 0 where nothing was measured.
    #[getter]
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let make = || {
            let metres = match &self.frame.depth {
                DepthImage::Raw(raw) => raw.data().iter().map(|&value| self.calibration.metres(value)).collect(),
                DepthImage::Metres(metres) => metres.data().to_vec(),
            };
            arrays::read_only(arrays::plane(py, self.frame.depth.size(), metres)?).map(Bound::unbind)
        };
        Ok(self.depth.get_or_try_init(py, make)?.bind(py).clone())
    }

    /// Depth as the sensor gave it, HxW uint16; None where the recording has metres.
    #[getter]
    fn raw_depth<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<u16>>>> {
        let DepthImage::Raw(raw) = &self.frame.depth else { return Ok(None) };
        let make = || arrays::read_only(arrays::plane(py, raw.size(), raw.data().to_vec())?).map(Bound::unbind);
        Ok(Some(self.raw_depth.get_or_try_init(py, make)?.bind(py).clone()))
    }

    /// Red, green, blue, HxWx3 uint8; None where there is no colour.
    #[getter]
    fn colour<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<u8>>>> {
        let Some(colour) = &self.frame.colour else { return Ok(None) };
        let make = || {
            let pixels = colour.data().iter().map(|&[r, g, b, _]| [r, g, b]).collect();
            arrays::read_only(arrays::channels(py, colour.size(), pixels)?).map(Bound::unbind)
        };
        Ok(Some(self.colour.get_or_try_init(py, make)?.bind(py).clone()))
    }

    /// The recording's own pose of the depth camera, world_from_camera, 4x4 float64; None where it has none.
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.frame.world_from_camera.map(|pose| arrays::matrix(py, &pose)).transpose()
    }

    /// A gyroscope's readings since the frame before: Nx4 float64, seconds and rad/s in the sensor's axes.
    #[getter]
    fn gyroscope<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let row = |reading: &itm_core::AngularRate| {
            let [x, y, z] = reading.rad_per_s.to_array();
            [reading.timestamp.as_secs_f64(), x, y, z]
        };
        arrays::rows(py, self.frame.gyroscope.iter().map(row))
    }

    fn __repr__(&self) -> String {
        let (width, height) = self.frame.depth.size();
        let colour = if self.frame.colour.is_some() { "colour" } else { "no colour" };
        format!("<Frame {} at {} s, {width}x{height}, {colour}>", self.frame.index, self.frame.timestamp)
    }
}
