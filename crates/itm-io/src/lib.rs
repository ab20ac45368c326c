//! All that touches a file: recordings, calibrations, trajectories, meshes, point clouds and maps.

pub mod block_store;
pub mod calibration;
mod error;
mod export;
pub mod map_file;
mod matrix;
pub mod mesh;
mod ply;
pub mod points;
pub mod recording;
mod text;
pub mod trajectory;
mod whole_file;

pub use error::Error;
