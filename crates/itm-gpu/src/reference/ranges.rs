//! Reference of stage `ranges`: where along each ray a surface may lie (the report, section 3.4).

use glam::{DVec2, IVec3};
use itm_core::{Image, Intrinsics, Se3};

use super::map::{Map, corners};

/// Pixels along the side of the square that one range stands for.
pub const PIXELS_PER_RANGE: u32 = 8;

/// For each 8x8 pixels the nearest and farthest depth (metres along the optical axis) of all given blocks whose bounding
/// box in the image reaches there; `None` where there is none. A block reaches up to its neighbours' first voxels.
///
/// `margin_px` widens the boxes to all sides. A block that reaches behind the camera, or nearer than a millimetre, may
/// appear anywhere.
pub fn ranges(
    map: &Map,
    visible: &[IVec3],
    camera: &Intrinsics,
    world_from_camera: &Se3,
    margin_px: f64,
) -> Image<Option<[f32; 2]>> {
    let camera_from_world = world_from_camera.inverse();
    let (width, height) = (camera.width.div_ceil(PIXELS_PER_RANGE), camera.height.div_ceil(PIXELS_PER_RANGE));
    let mut image: Image<Option<[f32; 2]>> = Image::filled(width, height, None);
    for position in visible {
        let block = corners()
            .map(|corner| camera_from_world.transform_point((*position + corner).as_dvec3() * map.block_size_m()));
        let block: Vec<_> = block.collect();
        let near = block.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
        let far = block.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
        if far <= 0.0 {
            continue;
        }
        let (mut lower, mut upper) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        if near < 1e-3 {
            (lower, upper) = (upper, lower);
        }
        for pixel in block.iter().filter_map(|corner| camera.project(*corner)) {
            lower = lower.min(pixel);
            upper = upper.max(pixel);
        }
        // Pixels reach half a pixel beyond their centres.
        let side = f64::from(PIXELS_PER_RANGE);
        let first = ((lower + 0.5 - margin_px) / side).floor();
        let last = ((upper + 0.5 + margin_px) / side).floor();
        for y in 0..height {
            for x in 0..width {
                let here = DVec2::new(x.into(), y.into());
                if here.cmpge(first).all() && here.cmple(last).all() {
                    let [old_near, old_far] = image[(x, y)].unwrap_or([f32::INFINITY, 0.0]);
                    let new = [old_near.min(near.max(1e-6) as f32), old_far.max(far as f32)];
                    image.data_mut()[(y * width + x) as usize] = Some(new);
                }
            }
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_point_of_a_block_lies_within_its_ranges(
            position in [-4..4, -4..4, -2..12],
            within in [0.0..1.0, 0.0..1.0, 0.0..1.0],
            twist in [-0.5..0.5, -0.5..0.5, -0.5..0.5, -1.0..1.0, -1.0..1.0, -1.0..1.0],
            voxel_size_m in 0.005f32..0.1,
        ) {
            let camera = Intrinsics::new(81, 61, 70.0, -68.0, 40.2, 28.9);
            let map = Map::new(voxel_size_m, 4.0 * voxel_size_m);
            let position = IVec3::from_array(position);
            let pose = Se3::exp(twist);
            let ranges = ranges(&map, &[position], &camera, &pose, 0.0);
            let world = (position.as_dvec3() + DVec3::from_array(within)) * map.block_size_m();
            let point = pose.inverse().transform_point(world);
            let inside = |p: &DVec2| p.min_element() >= 0.0 && p.x < 81.0 && p.y < 61.0;
            if let Some(pixel) = camera.project(point).map(|p| (p + 0.5).floor()).filter(inside) {
                let range = ranges[(pixel.x as u32 / 8, pixel.y as u32 / 8)];
                let [near, far] = range.expect("the block is seen there").map(f64::from);
                prop_assert!(near <= point.z + 1e-6 && point.z <= far + 1e-6, "{point} not in {near} to {far}");
            }
        }
    }
}
