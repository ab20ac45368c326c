//! Numpy arrays in and out. Whatever comes in is copied, so that nobody changes it while it is worked on.

use glam::{DMat4, Vec3};
use itm_core::{Calibration, ColourImage, DepthImage, Image, Intrinsics, Se3, Timestamp};
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyUntypedArray,
    PyUntypedArrayMethods, get_array_module,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat};

/// What a value is, for an error: `a float64 array of shape (480, 640)`, or its type's name.
pub(crate) fn describe(value: &Bound<'_, PyAny>) -> String {
    if let Ok(array) = value.cast::<PyUntypedArray>() {
        let dtype = array.dtype().str().map_or_else(|_| "strange".into(), |s| s.to_string());
        let shape: Vec<String> = array.shape().iter().map(usize::to_string).collect();
        return format!("an array of {dtype} of shape ({})", shape.join(", "));
    }
    value.get_type().name().map_or_else(|_| "something else".into(), |name| name.to_string())
}

/// An array's values in row-major order, whatever its strides and alignment.
fn values<T: Element + Copy>(array: &Bound<'_, PyArrayDyn<T>>) -> PyResult<Vec<T>> {
    if !array.is_c_contiguous() || !array.getattr("flags")?.getattr("aligned")?.extract::<bool>()? {
        // Numpy is faster at that.
        let copy = array.call_method1("copy", ("C",))?;
        return Ok(copy.cast::<PyArrayDyn<T>>()?.to_vec()?);
    }
    // What is to be read may be being written to by another extension.
    Ok(array.try_readonly()?.as_slice()?.to_vec())
}

fn of_size<T>(camera: &Intrinsics, values: Vec<T>) -> PyResult<Image<T>> {
    Image::new(camera.width, camera.height, values).map_err(|error| PyValueError::new_err(error.to_string()))
}

fn check_size(shape: &[usize], camera: &Intrinsics, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    let (height, width) = (camera.height as usize, camera.width as usize);
    if shape == [height, width] {
        return Ok(());
    }
    let found = describe(value);
    Err(PyValueError::new_err(format!(
        "{name} must have the calibration's {height} rows and {width} columns, not be {found}"
    )))
}

/// A depth image: uint16 as the sensor gives it, or float32 metres.
pub(crate) fn depth(value: &Bound<'_, PyAny>, calibration: &Calibration) -> PyResult<DepthImage> {
    let camera = &calibration.depth;
    if let Ok(raw) = value.cast::<PyArrayDyn<u16>>() {
        check_size(raw.shape(), camera, "depth", value)?;
        Ok(DepthImage::Raw(of_size(camera, values(raw)?)?))
    } else if let Ok(metres) = value.cast::<PyArrayDyn<f32>>() {
        check_size(metres.shape(), camera, "depth", value)?;
        Ok(DepthImage::Metres(of_size(camera, values(metres)?)?))
    } else {
        let found = describe(value);
        Err(PyTypeError::new_err(format!(
            "depth must be an array of uint16 (raw values) or float32 (metres) with a row for each of the image's, not \
             {found}"
        )))
    }
}

/// A colour image: uint8, HxWx3 (red, green, blue), HxWx4 (and 0 where a pixel has no colour) or HxW (grey).
pub(crate) fn colour(value: &Bound<'_, PyAny>, calibration: &Calibration) -> PyResult<ColourImage> {
    let camera = &calibration.colour;
    let Ok(array) = value.cast::<PyArrayDyn<u8>>() else {
        let found = describe(value);
        return Err(PyTypeError::new_err(format!(
            "colour must be an array of uint8, HxWx3 (red, green, blue), HxWx4 or HxW (grey), not {found}"
        )));
    };
    let shape = array.shape();
    check_size(&shape[..shape.len().min(2)], camera, "colour", value)?;
    let channels = match shape {
        [_, _] => 1,
        [_, _, channels @ (3 | 4)] => *channels,
        _ => {
            let found = describe(value);
            return Err(PyValueError::new_err(format!(
                "colour must be HxWx3 (red, green, blue), HxWx4 or HxW (grey), not {found}"
            )));
        }
    };
    if channels > 1 && !array.is_c_contiguous() {
        // Numpy copies values one at a time where pixels lie apart; channel by channel it takes a third of that.
        let py = value.py();
        let channel = |number: usize| values(array.get_item((py.Ellipsis(), number))?.cast::<PyArrayDyn<u8>>()?);
        let (red, green, blue) = (channel(0)?, channel(1)?, channel(2)?);
        let alpha = if channels == 4 { channel(3)? } else { vec![u8::MAX; red.len()] };
        let pixels = red.iter().zip(&green).zip(&blue).zip(&alpha).map(|(((r, g), b), a)| [*r, *g, *b, *a]);
        return of_size(camera, pixels.collect());
    }
    let bytes = values(array)?;
    let pixels = match channels {
        1 => bytes.iter().map(|&grey| [grey, grey, grey, u8::MAX]).collect(),
        3 => bytes.as_chunks().0.iter().map(|&[r, g, b]| [r, g, b, u8::MAX]).collect(),
        _ => bytes.as_chunks().0.to_vec(),
    };
    of_size(camera, pixels)
}

/// Numbers of one shape from whatever numpy can make an array of.
fn numbers(value: &Bound<'_, PyAny>, name: &str, expected: &str) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let wrong = || PyTypeError::new_err(format!("{name} must be {expected}, not {}", describe(value)));
    let numpy = get_array_module(value.py())?;
    let array = numpy.call_method1("asarray", (value, "float64")).map_err(|_| wrong())?;
    let array = array.cast::<PyArrayDyn<f64>>().map_err(|_| wrong())?;
    Ok((array.shape().to_vec(), values(array)?))
}

fn motion(numbers: &[f64]) -> Result<Se3, String> {
    let rows: [f64; 16] = numbers.try_into().map_err(|_| "it has not 16 numbers".to_owned())?;
    if rows.iter().any(|number| !number.is_finite()) {
        return Err(itm_core::PoseError::NotFinite.to_string());
    }
    if rows[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(format!("its last row must be 0, 0, 0, 1, not {:?}", &rows[12..]));
    }
    Se3::try_from_matrix(DMat4::from_cols_array(&rows).transpose()).map_err(|error| error.to_string())
}

/// A rigid motion from a 4x4 matrix.
pub(crate) fn pose(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Se3> {
    let (shape, numbers) = numbers(value, name, "a 4x4 matrix")?;
    if shape != [4, 4] {
        return Err(PyValueError::new_err(format!("{name} must be a 4x4 matrix, not {}", describe(value))));
    }
    motion(&numbers).map_err(|reason| PyValueError::new_err(format!("{name} is no rigid motion: {reason}")))
}

/// Rigid motions from an array Nx4x4.
pub(crate) fn poses(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Se3>> {
    let (shape, numbers) = numbers(value, name, "an array of shape (N, 4, 4)")?;
    if !matches!(shape[..], [_, 4, 4]) && shape != [0] {
        return Err(PyValueError::new_err(format!("{name} must be of shape (N, 4, 4), not {}", describe(value))));
    }
    let of = |(i, numbers): (usize, &[f64])| {
        motion(numbers).map_err(|reason| PyValueError::new_err(format!("{name}[{i}] is no rigid motion: {reason}")))
    };
    numbers.chunks_exact(16).enumerate().map(of).collect()
}

/// Three numbers.
pub(crate) fn vector(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec3> {
    let (shape, numbers) = numbers(value, name, "three numbers")?;
    let [x, y, z] = numbers[..] else {
        return Err(PyValueError::new_err(format!("{name} must be three numbers, not of shape {shape:?}")));
    };
    Ok(glam::DVec3::new(x, y, z).as_vec3())
}

/// Points from an array Nx3.
pub(crate) fn points(value: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Vec3>> {
    let (shape, numbers) = numbers(value, name, "an array of shape (N, 3)")?;
    if !matches!(shape[..], [_, 3]) {
        return Err(PyValueError::new_err(format!("{name} must be of shape (N, 3), not {}", describe(value))));
    }
    Ok(numbers.as_chunks().0.iter().map(|&[x, y, z]| glam::DVec3::new(x, y, z).as_vec3()).collect())
}

/// A moment: an int is nanoseconds, a float seconds.
pub(crate) fn timestamp(value: &Bound<'_, PyAny>) -> PyResult<Timestamp> {
    let wrong = || {
        PyTypeError::new_err(format!(
            "a timestamp must be nanoseconds (int) or seconds (float), not {}",
            describe(value)
        ))
    };
    if value.is_instance_of::<PyBool>() {
        return Err(wrong());
    }
    if !value.is_instance_of::<PyFloat>()
        && let Ok(index) = value.call_method0("__index__")
    {
        let too_large = |_| PyValueError::new_err(format!("a timestamp of {index} ns does not fit 64 bits"));
        return index.extract::<i64>().map(Timestamp).map_err(too_large);
    }
    let seconds: f64 = value.extract().map_err(|_| wrong())?;
    if !(-9e9..9e9).contains(&seconds) {
        return Err(PyValueError::new_err(format!("a timestamp must be finite seconds below 9e9, not {seconds}")));
    }
    Ok(Timestamp::from_secs_f64(seconds))
}

/// Timestamps from an array of N: integers are nanoseconds, floats seconds.
pub(crate) fn timestamps(value: &Bound<'_, PyAny>) -> PyResult<Vec<Timestamp>> {
    let numpy = get_array_module(value.py())?;
    let array = numpy.call_method1("asarray", (value,))?;
    let shape = array.cast::<PyUntypedArray>()?.shape().to_vec();
    if shape.len() != 1 {
        return Err(PyValueError::new_err(format!("timestamps must be of shape (N,), not {}", describe(&array))));
    }
    array.try_iter()?.map(|item| timestamp(&item?)).collect()
}

/// A rigid motion as a 4x4 matrix.
pub(crate) fn matrix<'py>(py: Python<'py>, pose: &Se3) -> PyResult<Bound<'py, PyArray2<f64>>> {
    pose.to_matrix().transpose().to_cols_array().to_vec().into_pyarray(py).reshape([4, 4])
}

/// Rigid motions as an array Nx4x4.
pub(crate) fn matrices<'py>(py: Python<'py>, poses: impl Iterator<Item = Se3>) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let values: Vec<f64> = poses.flat_map(|pose| pose.to_matrix().transpose().to_cols_array()).collect();
    let count = values.len() / 16;
    values.into_pyarray(py).reshape([count, 4, 4])
}

/// An image as an array HxW.
pub(crate) fn plane<'py, T: Element>(
    py: Python<'py>,
    (width, height): (u32, u32),
    values: Vec<T>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    values.into_pyarray(py).reshape([height as usize, width as usize])
}

/// An image of several channels as an array HxWxC.
pub(crate) fn channels<'py, const C: usize>(
    py: Python<'py>,
    (width, height): (u32, u32),
    pixels: Vec<[u8; C]>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    pixels.into_flattened().into_pyarray(py).reshape([height as usize, width as usize, C])
}

/// Rows of numbers as an array NxC.
pub(crate) fn rows<'py, T: Element, const C: usize>(
    py: Python<'py>,
    rows: impl Iterator<Item = [T; C]>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let rows: Vec<[T; C]> = rows.collect();
    let count = rows.len();
    rows.into_flattened().into_pyarray(py).reshape([count, C])
}

/// An array that Python cannot write to, for values that are kept.
pub(crate) fn read_only<'py, A>(array: Bound<'py, A>) -> PyResult<Bound<'py, A>> {
    array.as_any().getattr("flags")?.setattr("writeable", false)?;
    Ok(array)
}

/// Numbers as an array of N.
pub(crate) fn row<T: Element>(py: Python<'_>, values: Vec<T>) -> Bound<'_, PyArray1<T>> {
    values.into_pyarray(py)
}
