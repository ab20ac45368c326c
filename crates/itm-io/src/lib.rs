//! All that touches a file: recordings, calibrations, trajectories and meshes.

mod error;

pub use error::Error;
