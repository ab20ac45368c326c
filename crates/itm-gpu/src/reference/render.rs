//! Reference of stage `render`, without the map's colours.

use glam::{DVec3, Vec3};
use itm_core::{ColourImage, Image, Se3};

use crate::render::{Scale, Shading};

/// The scale of colours at its nine steps, from its lower end up.
const STEPS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Paints points and normals as [`crate::RaycastImage`] holds them, seen from a pose. [`Shading::Colour`] paints nothing.
pub fn shade(
    points: &Image<[f32; 4]>,
    normals: &Image<[f32; 4]>,
    world_from_camera: &Se3,
    shading: Shading,
    scale: &Scale,
) -> ColourImage {
    ColourImage::from_fn(points.width(), points.height(), |x, y| {
        let ([px, py, pz, observed], [nx, ny, nz, known]) = (points[(x, y)], normals[(x, y)]);
        let (point, normal) = (Vec3::new(px, py, pz).as_dvec3(), Vec3::new(nx, ny, nz).as_dvec3());
        let colour = match shading {
            Shading::Grey if known > 0.0 => {
                let light = (world_from_camera.translation - point).normalize();
                Some(DVec3::splat(0.15 + 0.8 * normal.dot(light).abs()))
            }
            Shading::Phong if known > 0.0 => {
                let facing = normal.dot((world_from_camera.translation - point).normalize()).abs().min(1.0);
                let mirrored = (2.0 * facing * facing - 1.0).max(0.0);
                Some(DVec3::splat(0.1 + 0.6 * facing + 0.3 * mirrored.powi(20)))
            }
            Shading::Normals if known > 0.0 => Some(0.5 + 0.5 * normal),
            Shading::Depth if observed > 0.0 => {
                Some(on_scale(world_from_camera.inverse().transform_point(point).z, scale.depth_m))
            }
            Shading::Confidence if observed > 0.0 => {
                let confidence = if known >= 2.0 { known - 2.0 } else { observed - 1.0 };
                Some(on_scale(confidence.into(), [0.0, scale.confidence]))
            }
            _ => None,
        };
        let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
        colour.map_or([0; 4], |c| [byte(c.x), byte(c.y), byte(c.z), 255])
    })
}

fn on_scale(value: f64, [low, high]: [f32; 2]) -> DVec3 {
    let (low, high) = (f64::from(low), f64::from(high));
    let place = ((value - low) / (high - low)).clamp(0.0, 1.0) * 8.0;
    let below = (place as usize).min(7);
    let step = |i: usize| DVec3::from_array(STEPS[i].map(f64::from)) / 255.0;
    step(below).lerp(step(below + 1), place - below as f64)
}
