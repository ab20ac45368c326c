//! All that touches a file: recordings, calibrations, trajectories, meshes and point clouds.

pub mod calibration;
mod error;
mod export;
mod matrix;
pub mod mesh;
pub mod points;
pub mod recording;
mod text;
pub mod trajectory;

pub use error::Error;
