//! The stages of itm as shaders on wgpu.
//!
//! State objects ([`View`], [`BlockMap`], [`RaycastImage`]) hold data; stages ([`view::ViewStage`],
//! [`integrate::Integrate`] …) hold pipelines and record commands over state that they are given. Nothing here decides:
//! when to grow a pool, which pose to try next, what to do after a failure, is itm-slam's business.
//!
//! A stage has one name everywhere: its shader, its module here, its pipelines' labels, its CPU reference in
//! [`mod@reference`], its tests and its column in the timings.

pub mod absorb;
pub mod allocate;
pub mod associate;
mod canvas;
pub mod changed;
pub mod confidence;
mod device;
mod error;
pub mod evaluate;
pub mod forward;
pub mod hash;
pub mod icp;
pub mod integrate;
mod map;
pub mod mesh;
pub mod mesh_view;
pub mod normals;
pub mod photometric;
mod pipeline;
pub mod query;
pub mod ranges;
pub mod raycast;
mod recorder;
pub mod reference;
pub mod render;
mod scan;
mod scratch;
pub mod segment;
pub mod shrink;
pub mod splat;
mod state;
mod sums;
mod surfels;
pub mod swap;
pub mod view;
pub mod visible;

pub use canvas::Canvas;
pub use device::{AdapterKind, AdapterReport, Capabilities, Device};
pub use error::Error;
pub use map::{BlockMap, FrameRecord, HostBlock, MapLayout, RecordReader};
pub use raycast::RaycastImage;
pub use recorder::{Recorder, StageTimes};
pub use segment::Segmentation;
pub use state::MapState;
pub use sums::{DepthSums, PhotometricSums};
pub use surfels::{Part, SurfelMap, SurfelOptions, SurfelRecord, SurfelRecordReader, SurfelState, SurfelView};
pub use view::View;
