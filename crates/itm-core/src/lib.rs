//! The vocabulary of itm: poses, cameras, calibrations, images, frames, voxels, settings, trajectories,
//! meshes and point clouds.
//!
//! Nothing here opens a file, starts a thread or knows of a GPU.
//!
//! # Conventions
//! - Poses are named for what they do: `world_from_camera` takes camera coordinates to world coordinates, and
//!   `a_from_b * b_from_c` is `a_from_c`.
//! - A camera looks along +z, x points right and y down. Lengths are metres, angles radians, times nanoseconds.
//! - Pixel `(0, 0)` is the centre of the upper left pixel.

pub mod block;
mod calibration;
mod camera;
mod distortion;
pub mod evaluation;
mod frame;
mod geometry;
mod image;
mod mesh;
mod points;
pub mod sample;
mod se3;
mod settings;
pub mod surfel;
mod trajectory;
pub mod voxel;

pub use calibration::{Calibration, CalibrationError, DepthConversion};
pub use camera::Intrinsics;
pub use distortion::Distortion;
pub use frame::{AngularRate, DepthImage, Frame, Timestamp};
pub use geometry::GeometryError;
pub use image::{ColourImage, Image, ImageSizeError};
pub use mesh::{DroppedComponents, Mesh};
pub use points::PointCloud;
pub use se3::{PoseError, Se3};
pub use settings::{
    BilateralSettings, CompositePolicy, CompositeSettings, DenseSettings, DepthWeight, DeviceSettings,
    DynamicsSettings, ExtendedSettings, FileSettings, ForwardProjectionSettings, IcpSettings, ImuSettings,
    LIVE_SETTINGS, MapIndex, MapSettings, Mode, ObservationWeight, OnFailure, RelocaliserImage, RelocaliserKind,
    RelocaliserSettings, RgbSettings, Settings, SettingsError, SubmapSettings, SurfelSettings, Swapping, TrackerKind,
    TrackerSettings, VerdictSettings, ViewSettings,
};
pub use trajectory::{StampedPose, Trajectory};
