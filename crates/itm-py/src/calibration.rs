//! Cameras.

use std::path::PathBuf;

use itm_core::{DepthConversion, Distortion, Se3};
use numpy::PyArray2;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors;

/// A pinhole camera: image size, focal lengths and principal point in pixels; pixel (0, 0) is the centre of the upper left
/// one.
#[pyclass(module = "itm_slam", frozen, eq, from_py_object)]
#[derive(Clone, PartialEq)]
pub(crate) struct Intrinsics(pub(crate) itm_core::Intrinsics);

#[pymethods]
impl Intrinsics {
    #[new]
    fn new(width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        Self(itm_core::Intrinsics::new(width, height, fx, fy, cx, cy))
    }

    /// Image width in pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.0.width
    }

    /// Image height in pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.0.height
    }

    /// Focal length along x, in pixels.
    #[getter]
    fn fx(&self) -> f64 {
        self.0.fx
    }

    /// Focal length along y, in pixels; negative where the camera's y axis points up.
    #[getter]
    fn fy(&self) -> f64 {
        self.0.fy
    }

    /// Principal point, x, in pixels.
    #[getter]
    fn cx(&self) -> f64 {
        self.0.cx
    }

    /// Principal point, y, in pixels.
    #[getter]
    fn cy(&self) -> f64 {
        self.0.cy
    }

    /// The camera's 3x3 matrix, float64.
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let camera = &self.0;
        let rows = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]];
        arrays::rows(py, rows.into_iter())
    }

    /// The camera whose images of another size show about the same.
    fn scaled_to(&self, width: u32, height: u32) -> Self {
        Self(self.0.scaled_to(width, height))
    }

    fn __repr__(&self) -> String {
        let itm_core::Intrinsics { width, height, fx, fy, cx, cy } = self.0;
        format!("Intrinsics({width}, {height}, {fx}, {fy}, {cx}, {cy})")
    }
}

/// What is known of a depth camera and the colour camera beside it.
#[pyclass(module = "itm_slam", frozen, eq, from_py_object)]
#[derive(Clone, PartialEq)]
pub(crate) struct Calibration(pub(crate) itm_core::Calibration);

#[pymethods]
impl Calibration {
    #[new]
    #[pyo3(signature = (
        depth, colour=None, *, colour_from_depth=None, depth_scale=None, depth_offset=0.0, disparity=None,
        depth_distortion=None, colour_distortion=None,
    ))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn new(
        depth: &Intrinsics,
        colour: Option<&Intrinsics>,
        colour_from_depth: Option<&Bound<'_, PyAny>>,
        depth_scale: Option<f64>,
        depth_offset: f64,
        disparity: Option<(f64, f64)>,
        depth_distortion: Option<Vec<f64>>,
        colour_distortion: Option<Vec<f64>>,
    ) -> PyResult<Self> {
        let depth_conversion = match (disparity, depth_scale) {
            (Some(_), Some(_)) => {
                return Err(PyValueError::new_err(
                    "give depth_scale or disparity, not both: each says what raw depth means",
                ));
            }
            (Some((a, b)), None) => DepthConversion::Disparity { a, b },
            (None, scale) => DepthConversion::Affine { scale: scale.unwrap_or(0.001), offset: depth_offset },
        };
        let colour_from_depth = colour_from_depth.map(|value| arrays::pose(value, "colour_from_depth")).transpose()?;
        let calibration = itm_core::Calibration {
            depth: depth.0,
            colour: colour.unwrap_or(depth).0,
            colour_from_depth: colour_from_depth.unwrap_or(Se3::IDENTITY),
            depth_conversion,
            depth_distortion: distortion(depth_distortion, "depth_distortion")?,
            colour_distortion: distortion(colour_distortion, "colour_distortion")?,
        };
        calibration.validate().map_err(|error| errors::calibration(error.to_string()))?;
        Ok(Self(calibration))
    }

    /// Reads a calibration file in the format of the InfiniTAM v3 report.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        itm_io::calibration::read(&path).map(Self).map_err(|error| errors::of_io(&error, errors::calibration))
    }

    /// Writes such a file.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        itm_io::calibration::write(&path, &self.0).map_err(|error| errors::of_io(&error, errors::calibration))
    }

    /// The depth camera.
    #[getter]
    fn depth(&self) -> Intrinsics {
        Intrinsics(self.0.depth)
    }

    /// The colour camera; equal to the depth camera for registered images.
    #[getter]
    fn colour(&self) -> Intrinsics {
        Intrinsics(self.0.colour)
    }

    /// Takes depth-camera coordinates to colour-camera coordinates, 4x4 float64, metres.
    #[getter]
    fn colour_from_depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::matrix(py, &self.0.colour_from_depth)
    }

    /// Metres of a raw step of depth; None where raw depth is disparities.
    #[getter]
    fn depth_scale(&self) -> Option<f64> {
        match self.0.depth_conversion {
            DepthConversion::Affine { scale, .. } => Some(scale),
            DepthConversion::Disparity { .. } => None,
        }
    }

    /// Metres at raw depth 0; None where raw depth is disparities.
    #[getter]
    fn depth_offset(&self) -> Option<f64> {
        match self.0.depth_conversion {
            DepthConversion::Affine { offset, .. } => Some(offset),
            DepthConversion::Disparity { .. } => None,
        }
    }

    /// A Kinect's disparities, `depth = 8 b fx / (a - raw)`, as (a, b); None where raw depth is not of that kind.
    #[getter]
    fn disparity(&self) -> Option<(f64, f64)> {
        match self.0.depth_conversion {
            DepthConversion::Affine { .. } => None,
            DepthConversion::Disparity { a, b } => Some((a, b)),
        }
    }

    /// The lens's coefficients of the depth camera in OpenCV's order, 5 or 8 of them; None for a pinhole camera.
    #[getter]
    fn depth_distortion(&self) -> Option<Vec<f64>> {
        coefficients(&self.0.depth_distortion)
    }

    /// The same of the colour camera.
    #[getter]
    fn colour_distortion(&self) -> Option<Vec<f64>> {
        coefficients(&self.0.colour_distortion)
    }

    fn __repr__(&self) -> String {
        let text = itm_io::calibration::to_text(&self.0);
        let lines: Vec<&str> = text.lines().filter(|line| !line.is_empty()).collect();
        format!("<Calibration {}>", lines.join("; "))
    }
}

fn distortion(given: Option<Vec<f64>>, name: &str) -> PyResult<Distortion> {
    let Some(given) = given else { return Ok(Distortion::None) };
    match given[..] {
        [] => Ok(Distortion::None),
        [k1, k2, p1, p2] => Ok(Distortion::brown([k1, k2, p1, p2, 0.0])),
        [k1, k2, p1, p2, k3] => Ok(Distortion::brown([k1, k2, p1, p2, k3])),
        [k1, k2, p1, p2, k3, k4, k5, k6] => Ok(Distortion::Rational { k1, k2, p1, p2, k3, k4, k5, k6 }),
        _ => Err(PyValueError::new_err(format!(
            "{name} must have 4, 5 or 8 coefficients in OpenCV's order (k1, k2, p1, p2, k3, k4, k5, k6), not {}",
            given.len()
        ))),
    }
}

fn coefficients(lens: &Distortion) -> Option<Vec<f64>> {
    match lens {
        Distortion::None => None,
        Distortion::Brown { .. } => Some(lens.coefficients()[..5].to_vec()),
        Distortion::Rational { .. } => Some(lens.coefficients().to_vec()),
    }
}

/// A calibration from what has one: itself, or one camera for registered images with depth in millimetres.
pub(crate) fn of(value: &Bound<'_, PyAny>) -> PyResult<itm_core::Calibration> {
    if let Ok(calibration) = value.cast::<Calibration>() {
        return Ok(calibration.get().0);
    }
    if let Ok(camera) = value.cast::<Intrinsics>() {
        let calibration = itm_core::Calibration::registered(camera.get().0, DepthConversion::MILLIMETRES);
        calibration.validate().map_err(|error| errors::calibration(error.to_string()))?;
        return Ok(calibration);
    }
    let found = arrays::describe(value);
    Err(PyTypeError::new_err(format!(
        "calibration must be a Calibration, the Intrinsics of one camera for both images, a Recording or a Sequence, not \
         {found}"
    )))
}
