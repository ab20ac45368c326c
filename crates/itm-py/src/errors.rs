//! Python's exceptions for the workspace's errors.

use std::error::Error as StdError;

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;

create_exception!(itm_slam, Error, PyException, "What can go wrong in itm_slam; the base of its other errors.");
create_exception!(itm_slam, SettingsError, Error, "Settings that are not known, or that cannot be meant.");
create_exception!(itm_slam, CalibrationError, Error, "A calibration that cannot be used.");
create_exception!(itm_slam, RecordingError, Error, "A recording, or a frame of it, that cannot be read or written.");
create_exception!(itm_slam, MapError, Error, "A map file that cannot be read, written, or gone on from.");
create_exception!(itm_slam, DeviceError, Error, "No graphics adapter that would do, or one that failed.");
create_exception!(itm_slam, TrajectoryError, Error, "Trajectories that cannot be read, written or compared.");
create_exception!(itm_slam, ExportError, Error, "A mesh or point cloud that cannot be written.");

/// Makes an exception from its message.
pub(crate) type Make = fn(String) -> PyErr;

/// A recording's error.
pub(crate) fn recording(message: String) -> PyErr {
    RecordingError::new_err(message)
}

/// A map file's error.
pub(crate) fn map(message: String) -> PyErr {
    MapError::new_err(message)
}

/// A trajectory's error.
pub(crate) fn trajectory(message: String) -> PyErr {
    TrajectoryError::new_err(message)
}

/// An error of a mesh's or point cloud's file.
pub(crate) fn export(message: String) -> PyErr {
    ExportError::new_err(message)
}

/// A calibration's error.
pub(crate) fn calibration(message: String) -> PyErr {
    CalibrationError::new_err(message)
}

/// The exception for an error with a file; `otherwise` makes that for one that says nothing of the file's kind.
pub(crate) fn of_io(error: &itm_io::Error, otherwise: Make) -> PyErr {
    use itm_io::Error::{
        Calibration, MapContent, MapCutOff, MapDamaged, MapVersion, NoCalibration, NoMapSection, NotAMap,
    };
    let make = match error {
        Calibration { .. } | NoCalibration { .. } => calibration,
        NotAMap { .. }
        | MapVersion { .. }
        | MapCutOff { .. }
        | MapDamaged { .. }
        | MapContent { .. }
        | NoMapSection { .. } => map,
        _ => otherwise,
    };
    make(error.to_string())
}

/// The exception for an error of a session; `file` makes that for a file which is not of a kind of its own.
pub(crate) fn of_slam(error: itm_slam::Error, file: Make) -> PyErr {
    use itm_slam::Error as E;
    match error {
        E::Gpu(itm_gpu_error) => of_gpu(&itm_gpu_error),
        E::Io(error) => of_io(&error, file),
        E::Settings(error) => of_settings(&error),
        E::Calibration(error) => calibration(error.to_string()),
        E::NoPoses { .. } | E::NoInertialSensor { .. } | E::NoPoseOfFrame { .. } | E::NoSuchFrames { .. } => {
            recording(error.to_string())
        }
        E::PosesAreGiven
        | E::NothingToTrackAgainst
        | E::ChangesNotTracked
        | E::NeedsVoxels { .. }
        | E::NoColour { .. } => SettingsError::new_err(error.to_string()),
        E::Relocaliser(_)
        | E::SavedState { .. }
        | E::OtherMap { .. }
        | E::NoKeyframes { .. }
        | E::UnusableKeyframes { .. }
        | E::EmptyMap { .. }
        | E::NoSubmapPose { .. }
        | E::TwoSubmapPoses { .. }
        | E::SubmapPose { .. }
        | E::SubmapOutOfReach { .. } => map(error.to_string()),
        // Whatever else concerns what was opened.
        _ => map(error.to_string()),
    }
}

/// The exception for an error of a device.
pub(crate) fn of_gpu(error: &itm_slam::DeviceError) -> PyErr {
    if matches!(error, itm_slam::DeviceError::ImageSize { .. }) {
        return PyValueError::new_err(error.to_string());
    }
    let mut message = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        message.push_str(&format!(": {error}"));
        cause = error.source();
    }
    DeviceError::new_err(message)
}

/// The exception for settings.
pub(crate) fn of_settings(error: &itm_core::SettingsError) -> PyErr {
    SettingsError::new_err(error.to_string())
}

/// Adds the exceptions to the module.
pub(crate) fn add_to(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("Error", py.get_type::<Error>())?;
    module.add("SettingsError", py.get_type::<SettingsError>())?;
    module.add("CalibrationError", py.get_type::<CalibrationError>())?;
    module.add("RecordingError", py.get_type::<RecordingError>())?;
    module.add("MapError", py.get_type::<MapError>())?;
    module.add("DeviceError", py.get_type::<DeviceError>())?;
    module.add("TrajectoryError", py.get_type::<TrajectoryError>())?;
    module.add("ExportError", py.get_type::<ExportError>())
}
