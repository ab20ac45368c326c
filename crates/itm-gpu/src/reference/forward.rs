//! Reference of stage `forward`: the points of the frame before, seen from this frame's pose (the report, section 3.4).

use glam::{DVec2, DVec3};
use itm_core::{Image, Intrinsics, Se3};

/// For each pixel the index of the point (world frame, metres) that it gets: the nearest of those that fall into it within a
/// range of depths in metres, and of several at the same depth the first.
pub fn forward(
    points: &[Option<DVec3>],
    camera: &Intrinsics,
    world_from_camera: &Se3,
    depth_range_m: [f32; 2],
) -> Image<Option<usize>> {
    let camera_from_world = world_from_camera.inverse();
    let mut chosen: Vec<Option<(usize, f64)>> = vec![None; camera.pixels()];
    for (i, point) in points.iter().enumerate() {
        let Some(p) = point.map(|point| camera_from_world.transform_point(point)) else { continue };
        let Some((x, y)) = pixel_of(p, camera, depth_range_m) else { continue };
        let held = &mut chosen[(y * camera.width + x) as usize];
        if held.is_none_or(|(_, z)| p.z < z) {
            *held = Some((i, p.z));
        }
    }
    Image::from_fn(camera.width, camera.height, |x, y| chosen[(y * camera.width + x) as usize].map(|(i, _)| i))
}

/// The pixel whose square a point (camera frame, metres) falls into.
fn pixel_of(p: DVec3, camera: &Intrinsics, depth_range_m: [f32; 2]) -> Option<(u32, u32)> {
    if p.z < f64::from(depth_range_m[0]) || p.z > f64::from(depth_range_m[1]) {
        return None;
    }
    let position = (camera.project(p)? + 0.5).floor();
    let size = DVec2::new(camera.width.into(), camera.height.into());
    let inside = position.cmpge(DVec2::ZERO).all() && position.cmplt(size).all();
    inside.then_some((position.x as u32, position.y as u32))
}
