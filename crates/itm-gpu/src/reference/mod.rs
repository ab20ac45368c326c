//! CPU references of the stages: written to be read and to test against; no pipeline runs on them.
//!
//! Each stage's reference has its name and is a set of pure functions, single-threaded and in double precision, straight
//! from the paper that its doc comment names. Where a result depends on which side of a border a number falls, and
//! single precision may see it on the other side, functions take a margin: asked once with a positive and once with a
//! negative one, they bracket what a correct kernel may answer.

pub mod absorb;
pub mod allocate;
pub mod associate;
pub mod changed;
pub mod forward;
pub mod hash;
pub mod icp;
pub mod integrate;
mod map;
pub mod mesh;
pub mod mesh_view;
pub mod normals;
pub mod photometric;
pub mod query;
pub mod ranges;
pub mod raycast;
pub mod render;
pub mod segment;
pub mod shrink;
pub mod splat;
pub mod view;
pub mod visible;

pub use map::{Block, Map};
