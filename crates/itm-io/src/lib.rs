//! All that touches a file: recordings, calibrations, trajectories and meshes.

pub mod calibration;
mod error;
mod text;

pub use error::Error;
