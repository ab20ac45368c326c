//! Dense RGB-D SLAM: camera tracking, volumetric mapping and coloured meshes, on any GPU that wgpu knows.
//!
//! [`SavedMap`] opens the map file of an earlier run, meshes it and renders it, in bounded memory.
//!
//! [`Slam`] is the core: push frames in, get poses out, ask for a mesh or a picture at any time. It is synchronous and
//! starts no thread. [`Session`] runs it over a recording, with decoding ahead on another thread, as a stream of events;
//! [`CameraLoop`] runs it beside a camera's own loop.
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
//! # Ok(())
//! # }
//! ```

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
pub mod tracking;
mod views;
mod warning;

pub use atlas::{Submap, SubmapLink};
pub use camera_loop::{CameraLoop, Stopper, WhenLate};
pub use chunked_mesh::{MeshOptions, mesh_blocks, mesh_in_chunks, with_neighbours};
pub use combined::Combined;
pub use decimate::{DecimateError, decimate};
pub use error::Error;
pub use frame_result::{FrameReport, FrameResult, FrameStatus, Notice};
pub use happening::{Happening, Optimised};
pub use itm_io::map_file::SubmapState;
pub use painting::Look;
pub use saved::SavedMap;
pub use saving::{SavedSession, count_surfels, settings_of};
pub use session::{Event, Session, SessionOptions, Start, Summary};
pub use slam::{Poses, Sighting, Slam};
pub use source::BlockSource;
pub use surfels::{SeenSurfels, bytes_per_surfel};
pub use views::{MapViews, full_confidence};
pub use warning::Warning;

pub use itm_core::*;
pub use itm_gpu::render::{Scale, Shading};
pub use itm_gpu::{
    AdapterKind, AdapterReport, Canvas, Capabilities, Device, Error as DeviceError, FrameRecord, MapLayout,
    SurfelRecord,
};
pub use itm_reloc::{AveragePose, Keyframe};
