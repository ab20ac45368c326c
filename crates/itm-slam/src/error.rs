//! What can go wrong in a run.

use thiserror::Error;

/// What can go wrong in a run.
#[derive(Debug, Error)]
pub enum Error {
    /// On the device.
    #[error(transparent)]
    Gpu(#[from] itm_gpu::Error),
    /// In a recording.
    #[error(transparent)]
    Io(#[from] itm_io::Error),
    /// In the settings.
    #[error(transparent)]
    Settings(#[from] itm_core::SettingsError),
    /// In the calibration.
    #[error(transparent)]
    Calibration(#[from] itm_core::CalibrationError),
    /// Given poses were asked for, and the recording has none.
    #[error("the recording '{recording}' has no poses, so it cannot be fused with given ones")]
    NoPoses {
        /// Its name.
        recording: String,
    },
    /// A range of frames that the recording does not have.
    #[error("frames {first} to {last} were asked for, but the recording '{recording}' has {frames}")]
    NoSuchFrames {
        /// Its name.
        recording: String,
        /// First frame asked for.
        first: usize,
        /// Last frame asked for.
        last: usize,
        /// Number of frames there are.
        frames: usize,
    },
}
