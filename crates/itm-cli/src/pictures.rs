//! Rendered pictures of the model for the report.

use glam::{DMat3, DQuat, DVec3};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use itm_core::{Intrinsics, Mesh, Se3, Trajectory};
use itm_slam::{Shading, Slam};

/// Widest picture, in pixels.
const MAX_WIDTH: u32 = 640;

/// A picture of the model.
pub(crate) struct Picture {
    /// What it shows.
    pub(crate) title: String,
    /// A PNG file, or why there is none.
    pub(crate) png: Result<Vec<u8>, String>,
}

/// Pictures from the last pose, the first and from behind them all; none without a pose.
pub(crate) fn of(slam: &mut Slam, mesh: Option<&Mesh>) -> Vec<Picture> {
    let camera = slam.calibration().depth;
    let height = (f64::from(camera.height) * f64::from(MAX_WIDTH) / f64::from(camera.width)).round().max(1.0) as u32;
    let camera = if camera.width > MAX_WIDTH { camera.scaled_to(MAX_WIDTH, height) } else { camera };
    let settings = slam.settings();
    let reach_m = settings.view.max_depth_m + settings.map.truncation_m;
    let coloured = settings.map.colour && settings.view.colour;
    let trajectory = slam.trajectory();
    let (Some(first), Some(last)) = (trajectory.poses().first(), trajectory.poses().last()) else { return Vec::new() };
    let (first, last) = (first.world_from_camera, last.world_from_camera);
    let behind = from_behind(trajectory, mesh, &camera);

    let mut views = vec![("last pose", last, reach_m, Shading::Grey), ("last pose", last, reach_m, Shading::Normals)];
    if coloured {
        views.insert(0, ("last pose", last, reach_m, Shading::Colour));
    }
    let best = if coloured { Shading::Colour } else { Shading::Grey };
    views.push(("first pose", first, reach_m, best));
    if let Some((behind, depth_m)) = behind {
        views.push(("overview", behind, depth_m, best));
        views.push(("overview", behind, depth_m, Shading::Grey));
    }
    let mut painted = |(from, pose, depth_m, shading)| {
        let shown = match shading {
            Shading::Grey | Shading::Phong => "shape",
            Shading::Normals => "normals",
            Shading::Colour => "colour",
            Shading::Depth => "depth",
            Shading::Confidence => "confidence",
        };
        let image = slam.render(&camera, &pose, depth_m, shading).map_err(|error| error.to_string());
        let png = image.and_then(|image| encode(image.size(), image.data().as_flattened()));
        Picture { title: format!("{from}, {shown}"), png }
    };
    views.into_iter().map(&mut painted).collect()
}

pub(crate) fn encode((width, height): (u32, u32), rgba: &[u8]) -> Result<Vec<u8>, String> {
    let mut png = Vec::new();
    let encoder = PngEncoder::new(&mut png);
    encoder.write_image(rgba, width, height, ExtendedColorType::Rgba8).map_err(|error| error.to_string())?;
    Ok(png)
}

/// A camera behind and above the trajectory that looks the way the camera mostly looked and has what it saw in view,
/// with the depth to which it must see.
fn from_behind(trajectory: &Trajectory, mesh: Option<&Mesh>, camera: &Intrinsics) -> Option<(Se3, f32)> {
    let poses = trajectory.poses();
    let n = poses.len() as f64;
    let mean = |of: &dyn Fn(&Se3) -> DVec3| poses.iter().map(|p| of(&p.world_from_camera)).sum::<DVec3>() / n;
    let position = mean(&|pose| pose.translation);
    let up = mean(&|pose| up(pose, camera)).try_normalize()?;
    // A camera that turned around looked nowhere in particular: then the way it looked at first will do.
    let forward = Some(mean(&|pose| pose.rotation * DVec3::Z)).filter(|mean| mean.length() > 0.3);
    let forward = forward.or_else(|| Some(poses.first()?.world_from_camera.rotation * DVec3::Z))?.normalize();
    let mesh = mesh.filter(|mesh| !mesh.positions.is_empty())?;
    let inverse_n = 1.0 / mesh.positions.len() as f64;
    let middle = mesh.positions.iter().map(|p| p.as_dvec3()).sum::<DVec3>() * inverse_n;
    let mut distances: Vec<f64> = mesh.positions.iter().map(|p| p.as_dvec3().distance(middle)).collect();
    distances.sort_unstable_by(f64::total_cmp);
    // Without the stray bits far out.
    let radius = *distances.get((distances.len() - 1) * 9 / 10)?;
    // Far enough for that sphere to fill most of the image's smaller side, and at least where the camera was.
    let half_view = 0.5 * f64::from(camera.width.min(camera.height)) / camera.fx;
    let back = (0.8 * radius / half_view).max((middle - position).dot(forward));
    let eye = middle - forward * back + up * 0.35 * back;
    Some((look_at(eye, middle, up, camera)?, (back * 1.1 + 2.0 * radius) as f32))
}

/// Which way is up for a camera that is held upright.
fn up(world_from_camera: &Se3, camera: &Intrinsics) -> DVec3 {
    world_from_camera.rotation * DVec3::new(0.0, -camera.fy.signum(), 0.0)
}

fn look_at(eye: DVec3, target: DVec3, up: DVec3, camera: &Intrinsics) -> Option<Se3> {
    let forward = (target - eye).try_normalize()?;
    // Of a camera with negative fy (ICL-NUIM) the y axis points up in the image, and its world is mirrored with it.
    let y_axis = -up * camera.fy.signum();
    let x_axis = y_axis.cross(forward).try_normalize()?;
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x_axis, forward.cross(x_axis), forward));
    Some(Se3::new(rotation, eye))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upright_camera_sees_its_target_in_the_middle_and_up_above_it() {
        let camera = Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5);
        let (eye, target) = (DVec3::new(1.0, -2.0, 0.5), DVec3::new(-1.0, 0.5, 3.0));
        let up = DVec3::new(0.0, -1.0, 0.0);
        for camera in [camera, Intrinsics { fy: -525.0, ..camera }] {
            let camera_from_world = look_at(eye, target, up, &camera).unwrap().inverse();
            let seen = |p| camera.project(camera_from_world.transform_point(p)).unwrap();
            assert!(seen(target).distance(glam::DVec2::new(319.5, 239.5)) < 1e-9);
            assert!(seen(target + 0.1 * up).y < 239.0);
        }
        assert_eq!(look_at(eye, eye, up, &camera), None);
    }
}
