//! Dense RGB-D SLAM: camera tracking, volumetric mapping and coloured meshes, on any GPU that wgpu knows.
//!
//! ```no_run
//! use itm_slam::{Calibration, DepthConversion, Device, Frame, Intrinsics, Poses, Settings, Slam};
//! # fn next_frame() -> Option<Frame> { None }
//! # fn main() -> Result<(), itm_slam::Error> {
//! let camera = Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5);
//! let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
//! let mut slam = Slam::new(&Device::open("auto")?, &calibration, &Settings::default(), Poses::Tracked)?;
//! while let Some(frame) = next_frame() {
//!     let result = slam.process(&frame)?;
//!     println!("{:?}", result.world_from_camera);
//! }
//! let mesh = slam.mesh(&mut |_, _| ())?;
//! itm_slam::io::mesh::write("room.ply".as_ref(), &mesh, &Default::default())?;
//! # Ok(())
//! # }
//! ```
//!
//! [`Slam`] is the core: push frames in, get poses out, ask for a mesh or a picture at any time. It is synchronous; the one
//! thread that it starts, where there are submaps, optimises their poses, and its result is taken over at a fixed frame.
//! [`Session`] runs it over a recording, with decoding ahead on another thread, as a stream of events; [`CameraLoop`] runs it
//! beside a camera's own loop. [`SavedMap`] opens the map file of an earlier run, meshes it and renders it, in bounded memory.
//!
//! # Conventions
//!
//! Metres, seconds and radians; where a number's type does not say its unit, its name does (`voxel_size_m`). Poses are named for
//! what they do: `world_from_camera` takes a point from the camera's frame to the world's, and `a_from_b * b_from_c` is
//! `a_from_c`. A camera looks along z, with x to the right and y down; the world is where the first frame's camera was. Depth is
//! along the optical axis. Times are nanoseconds ([`Timestamp`]).

mod atlas;
mod camera_loop;
mod caster;
mod changing;
mod chunked_mesh;
mod chunks;
mod combined;
mod decimate;
mod error;
mod frame_result;
mod happening;
mod link;
mod live;
mod local;
mod mapper;
mod painting;
mod places;
mod robot;
mod saved;
mod saving;
mod session;
mod slam;
mod source;
mod submaps;
mod surfels;
mod swapping;
#[doc(hidden)]
pub mod tracking;
mod views;
mod warning;

pub use atlas::{Submap, SubmapLink};
pub use camera_loop::{CameraLoop, Stopper, WhenLate};
pub use chunked_mesh::{MeshOptions, mesh_in_chunks, with_neighbours};
pub use combined::Combined;
pub use decimate::{DecimateError, decimate};
pub use error::Error;
pub use frame_result::{FrameReport, FrameResult, FrameStatus, Notice};
pub use happening::{Happening, Optimised};
pub use itm_io::map_file::SubmapState;
pub use painting::Look;
pub use saved::SavedMap;
pub use saving::SavedSession;
#[doc(hidden)]
pub use saving::{count_surfels, settings_of};
pub use session::{Event, Session, SessionOptions, Start, Summary};
pub use slam::{Poses, Sighting, Slam};
pub use source::BlockSource;
pub use surfels::SeenSurfels;
#[doc(hidden)]
pub use surfels::bytes_per_surfel;
pub use tracking::{Tracked, Verdict};
pub use views::{MapViews, full_confidence};
pub use warning::Warning;

pub use glam;
pub use itm_core::sample::Sample;
pub use itm_core::surfel::Surfel;
pub use itm_core::voxel::BlockKey;
pub use itm_core::*;
pub use itm_gpu::render::{Scale, Shading};
pub use itm_gpu::{
    AdapterKind, AdapterReport, Canvas, Capabilities, Device, Error as DeviceError, FrameRecord, MapLayout,
    SurfelRecord,
};
/// Recordings, trajectories, meshes and map files.
pub use itm_io as io;
pub use itm_reloc::{AveragePose, Error as RelocaliserError, Keyframe};
pub use nalgebra;
