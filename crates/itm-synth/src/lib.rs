//! Synthetic RGB-D recordings with exact poses and an exact surface.
//!
//! A [`Scene`] is made of solids described by their signed distance ([`Shape`]) and covered with patterns
//! ([`Material`]); [`SceneName`] lists those that come with the crate. A [`Sequence`] is what a camera records of one on a
//! [`Path`], frame by frame in memory, with the imperfections that its [`Spec`] asks for ([`DepthNoise`], [`Cover`],
//! [`Exposure`], ...); [`write_recording`] puts that into a folder in the format of the TUM RGB-D
//! benchmark, with gyroscope, accelerometer and calibration. [`exact_mesh`] is the surface that a reconstruction ought
//! to find.
//!
//! Worlds are in metres with y pointing down, so that a level camera's axes are the world's. Everything follows from a
//! seed and does not depend on the number of threads.

mod carried;
mod corridor;
mod cover;
mod error;
mod exposure;
mod fittings;
mod furniture;
mod hall;
mod inertial;
mod name;
mod noise;
mod path;
mod random;
mod render;
mod room;
mod rooms;
mod route;
mod scene;
mod sequence;
mod shape;
mod surface;
mod texture;
mod two_rooms;
mod walk;
mod wall;
mod write;

pub use cover::{Cover, Covering};
pub use error::Error;
pub use exposure::{Brightness, Exposure};
pub use inertial::{GRAVITY_WORLD, InertialNoise, InertialReading};
pub use name::SceneName;
pub use noise::DepthNoise;
pub use path::Path;
pub use render::{Quality, Rendering, render, render_depth};
pub use scene::{Bounds, Lamp, Object, Sample, Scene};
pub use sequence::{Sequence, Spec};
pub use shape::Shape;
pub use surface::exact_mesh;
pub use texture::{Material, Motif, Texture, colour};
pub use write::{Written, write_recording, write_recording_until};
