//! All that touches a file: recordings, calibrations, trajectories, meshes and maps.

pub mod block_store;
pub mod calibration;
mod error;
pub mod map_file;
mod matrix;
pub mod mesh;
pub mod recording;
mod text;
pub mod trajectory;
mod whole_file;

pub use error::Error;
