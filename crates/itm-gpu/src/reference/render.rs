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
            Shading::Grey | Shading::Phong if known > 0.0 => {
                Some(lit(shading, normal.dot((world_from_camera.translation - point).normalize())))
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
        colour.map_or([0; 4], bytes)
    })
}

/// Grey by the cosine of the angle between a normal and the light.
pub(super) fn lit(shading: Shading, cosine: f64) -> DVec3 {
    let facing = cosine.abs().min(1.0);
    if shading == Shading::Phong {
        let mirrored = (2.0 * facing * facing - 1.0).max(0.0);
        DVec3::splat(0.1 + 0.6 * facing + 0.3 * mirrored.powi(20))
    } else {
        DVec3::splat(0.15 + 0.8 * facing)
    }
}

/// A colour of 0 to 1 as a pixel that shows something.
pub(super) fn bytes(colour: DVec3) -> [u8; 4] {
    let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    [byte(colour.x), byte(colour.y), byte(colour.z), 255]
}

/// Puts a picture of points, seen from a pose, onto a canvas where it is nearer than what is there.
pub fn compose(
    canvas: &mut ColourImage,
    depths: &mut Image<f32>,
    picture: &ColourImage,
    points: &Image<[f32; 4]>,
    map_from_camera: &Se3,
) {
    let camera_from_map = map_from_camera.inverse();
    for (i, colour) in picture.data().iter().enumerate() {
        let [x, y, z, _] = points.data()[i];
        let depth = camera_from_map.transform_point(Vec3::new(x, y, z).as_dvec3()).z as f32;
        let before = depths.data()[i];
        if colour[3] > 0 && (before == 0.0 || depth < before) {
            depths.data_mut()[i] = depth;
            canvas.data_mut()[i] = *colour;
        }
    }
}

/// The colour of a value on the scale between two ends.
pub(super) fn on_scale(value: f64, [low, high]: [f32; 2]) -> DVec3 {
    let (low, high) = (f64::from(low), f64::from(high));
    scale_colour((value - low) / (high - low))
}

/// The colour of a place on the scale, from 0 to 1, as red, green and blue from 0 to 1. Hosts that show depth beside a picture
/// take it from here.
pub fn scale_colour(share: f64) -> DVec3 {
    let place = share.clamp(0.0, 1.0) * 8.0;
    let below = (place as usize).min(7);
    let step = |i: usize| DVec3::from_array(STEPS[i].map(f64::from)) / 255.0;
    step(below).lerp(step(below + 1), place - below as f64)
}
