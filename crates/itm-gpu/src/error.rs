//! What can go wrong on a device.

use thiserror::Error;

/// What can go wrong on a device.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// No adapter at all.
    #[error("no graphics adapter was found. {advice}")]
    NoAdapter {
        /// What to install on this platform.
        advice: &'static str,
    },
    /// No adapter like the one asked for.
    #[error("no graphics adapter matches '{wanted}'; there are: {found}")]
    NoSuchAdapter {
        /// What was asked for.
        wanted: String,
        /// The adapters that there are.
        found: String,
    },
    /// An adapter that cannot run the stages.
    #[error("{adapter} cannot run itm: it offers {found} {what}, {needed} are needed")]
    AdapterTooSmall {
        /// Its name.
        adapter: String,
        /// Which limit.
        what: &'static str,
        /// What it offers.
        found: u64,
        /// What is needed.
        needed: u64,
    },
    /// The driver refused to open the adapter.
    #[error("{adapter} could not be opened")]
    Open {
        /// Its name.
        adapter: String,
        /// The driver's reason.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A picture with no pixels, or too many along a side.
    #[error("a picture of {width}x{height} pixels: expected sides of 1 to {longest}, the device's longest")]
    CanvasSize {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// What a side may have.
        longest: u32,
    },
    /// The device stopped answering.
    #[error("the graphics device was lost: {reason}")]
    DeviceLost {
        /// The driver's reason.
        reason: String,
    },
    /// The device has no memory left.
    #[error("the graphics device is out of memory: {reason}")]
    OutOfMemory {
        /// The driver's reason.
        reason: String,
    },
    /// A view that reaches over more blocks than the device can index at once.
    #[error(
        "a view of {max_depth_m} m at a voxel size of {voxel_size_m} m reaches over {cells} blocks, this device indexes \
         {limit}: lower view.max_depth_m or raise map.voxel_size_m"
    )]
    ViewTooLarge {
        /// Farthest depth of the view.
        max_depth_m: f32,
        /// Edge of a voxel.
        voxel_size_m: f32,
        /// Blocks in the box around the view.
        cells: u64,
        /// What the device's largest buffer can index.
        limit: u64,
    },
    /// A view further from the origin than a block's 16 bits an axis reach.
    #[error(
        "a camera at {position_m:.1?} m sees further than the map reaches: {reach_m:.0} m from its origin at a voxel size of \
         {voxel_size_m} m. Give poses relative to a point of the scene, or raise map.voxel_size_m"
    )]
    OutOfReach {
        /// The camera's centre (world frame).
        position_m: [f64; 3],
        /// How far the map reaches along each axis.
        reach_m: f64,
        /// Edge of a voxel.
        voxel_size_m: f32,
    },
    /// An image larger than a buffer of the device.
    #[error("an image of {width}x{height} pixels needs more than the {limit} bytes that this device's buffers hold")]
    ImageTooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// Bytes of the largest buffer.
        limit: u64,
    },
    /// An image whose size is not the calibration's.
    #[error("the {image} image has {}x{} pixels, the calibration says {}x{}", found.0, found.1, expected.0, expected.1)]
    ImageSize {
        /// `depth` or `colour`.
        image: &'static str,
        /// Its width and height.
        found: (u32, u32),
        /// The calibration's.
        expected: (u32, u32),
    },
    /// A saved state whose parts do not fit together.
    #[error("the saved state of the {what} does not fit this session")]
    State {
        /// Of what.
        what: &'static str,
    },
    /// More blocks than the device can hold.
    #[error("{wanted} blocks do not fit: this device can hold {limit}")]
    TooManyBlocks {
        /// Blocks that the map would have had.
        wanted: u64,
        /// Blocks that it can have.
        limit: u32,
    },
    /// A mesh to be shown whose parts do not fit together.
    #[error("a mesh that cannot be shown: {reason}")]
    Mesh {
        /// Why.
        reason: itm_core::GeometryError,
    },
    /// A mesh with more vertices or triangles than 32 bits can number.
    #[error("the mesh of {blocks} blocks has more than 2^32 vertices or triangles: raise min_weight")]
    MeshTooLarge {
        /// Blocks of the map.
        blocks: u32,
    },
}
