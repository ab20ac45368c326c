//! Reference of stage `query`.

use glam::Vec3;
use itm_core::sample::{Cell, Sample};

use super::Map;

/// The signed distance and its gradient at a point (world frame, metres); `None` where one of the eight voxels around it was
/// never seen.
pub fn sample(map: &Map, point: Vec3) -> Option<Sample> {
    let cell = Cell::around(point, map.voxel_size_m)?;
    let voxels = cell.voxels().map(|voxel| map.distance(voxel)).map(|voxel| (voxel.distance(), voxel.weight()));
    cell.interpolate(voxels, map.voxel_size_m, map.truncation_m)
}
