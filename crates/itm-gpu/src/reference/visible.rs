//! Reference of stage `visible`: which blocks lie in the view's frustum (the report, section 3.2).

use glam::{DVec2, DVec3, IVec3};
use itm_core::{Intrinsics, Se3};

use super::map::Map;

/// Whether the sphere around a block's 8x8x8 voxels touches the camera's frustum between two depths (metres).
///
/// `margin_m` adds to the sphere's radius; a negative one shrinks it.
pub fn is_visible(
    map: &Map,
    position: IVec3,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    [near_m, far_m]: [f32; 2],
    margin_m: f64,
) -> bool {
    // Voxels lie on the lattice: the middle of 0 to 7 is 3.5.
    let centre_world = (position.as_dvec3() * 8.0 + 3.5) * f64::from(map.voxel_size_m);
    let centre = world_from_camera.inverse().transform_point(centre_world);
    let radius = 3.5 * 3.0_f64.sqrt() * f64::from(map.voxel_size_m) + margin_m;
    centre.z >= f64::from(near_m) - radius
        && centre.z <= f64::from(far_m) + radius
        && frustum_sides(camera).iter().all(|inward| inward.dot(centre) >= -radius)
}

/// The positions of all blocks of the map that are visible, in the order of the grid's cells, x fastest.
pub fn visible(map: &Map, camera: &Intrinsics, world_from_camera: &Se3, depth_range_m: [f32; 2]) -> Vec<IVec3> {
    let mut positions = map.positions();
    positions.retain(|p| is_visible(map, *p, camera, world_from_camera, depth_range_m, 0.0));
    positions
}

/// Inward unit normals of the planes through the camera's centre and the image's sides (camera frame): left, right,
/// upper, lower. Pixels reach half a pixel beyond their centres.
fn frustum_sides(camera: &Intrinsics) -> [DVec3; 4] {
    let last = DVec2::new(camera.width.into(), camera.height.into()) - 0.5;
    // Left and right of the image lie where the ray's x / z has these values; likewise above and below.
    let left_upper = camera.unproject(DVec2::splat(-0.5), 1.0);
    let right_lower = camera.unproject(last, 1.0);
    let (lower, upper) = (left_upper.min(right_lower), left_upper.max(right_lower));
    [
        DVec3::new(1.0, 0.0, -lower.x).normalize(),
        DVec3::new(-1.0, 0.0, upper.x).normalize(),
        DVec3::new(0.0, 1.0, -lower.y).normalize(),
        DVec3::new(0.0, -1.0, upper.y).normalize(),
    ]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn no_block_with_a_voxel_in_the_image_is_left_out(
            x in -20..20, y in -20..20, z in -5..40, voxel in [0..8, 0..8, 0..8], fy in prop_oneof![Just(60.0), Just(-60.0)],
        ) {
            let camera = Intrinsics::new(64, 48, 60.0, fy, 30.0, 25.0);
            let pose = Se3::exp([0.1, -0.2, 0.3, 0.4, -0.2, 0.6]);
            let map = Map::new(0.02, 0.08);
            let position = IVec3::new(x, y, z);
            let world = (position * 8 + IVec3::from_array(voxel)).as_dvec3() * 0.02;
            let point = pose.inverse().transform_point(world);
            let seen = camera.project(point).is_some_and(|p| {
                p.x >= -0.5 && p.y >= -0.5 && p.x <= 63.5 && p.y <= 47.5 && point.z >= 0.3 && point.z <= 3.0
            });
            prop_assert!(!seen || is_visible(&map, position, &camera, &pose, [0.3, 3.0], 1e-6));
        }
    }
}
