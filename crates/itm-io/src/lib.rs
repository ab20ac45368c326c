//! All that touches a file: recordings, calibrations, trajectories and meshes.

pub mod calibration;
mod error;
mod matrix;
pub mod mesh;
pub mod recording;
mod text;
pub mod trajectory;

pub use error::Error;
