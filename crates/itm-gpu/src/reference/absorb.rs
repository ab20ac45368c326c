//! Reference of stage `absorb`: measurements move the surfels that they belong to, or become surfels (Keller et al. 2013,
//! *Real-time 3D Reconstruction in Dynamic Scenes using Point-based Fusion*, sections 4.1, 4.2 and 5.2). Colours are fused
//! as voxels' are: [`super::integrate::fuse_colour`].

use glam::{DVec2, DVec3};
use itm_core::Intrinsics;
use itm_core::surfel::Surfel;

use super::associate::{Association, Measured, above, window};

/// Fused colours that a surfel's mean counts at most.
pub const MOST_COLOURS: u16 = 64;

/// What one pixel says of the surface.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// World frame, metres.
    pub point: DVec3,
    /// World frame.
    pub normal: DVec3,
    /// Radius of the pixel's disc, in metres.
    pub radius_m: f64,
    /// How much it counts.
    pub confidence: f64,
}

/// The sample of a pixel (numbered row by row), where there is a normal.
pub fn sample(measured: &Measured<'_>, pixel: usize) -> Option<Sample> {
    let (vertex, normal) = (measured.vertices.data()[pixel]?, measured.normals.data()[pixel]?);
    let camera = measured.camera;
    Some(Sample {
        point: measured.world_from_camera.transform_point(vertex),
        normal: measured.world_from_camera.transform_vector(normal),
        // Section 4.1: discs seen from the side are not drawn out beyond those at 75 degrees.
        radius_m: pixel_radius_m(measured, vertex.z) / normal.z.abs().max(0.26),
        confidence: confidence(camera, pixel, measured.settings.confidence_sigma.into()),
    })
}

/// Radius of the circle around a pixel, on a surface that faces the camera at a depth.
fn pixel_radius_m(measured: &Measured<'_>, z: f64) -> f64 {
    let focal = f64::midpoint(measured.camera.fx.abs(), measured.camera.fy.abs());
    f64::from(measured.settings.radius_factor) * std::f64::consts::FRAC_1_SQRT_2 / focal * z
}

/// Section 4.1: a Gaussian of the distance from the image's centre, in half the image's diagonal.
fn confidence(camera: &Intrinsics, pixel: usize, sigma: f64) -> f64 {
    let (x, y) = (pixel % camera.width as usize, pixel / camera.width as usize);
    let middle = DVec2::new(f64::from(camera.width - 1), f64::from(camera.height - 1)) / 2.0;
    let share = DVec2::new(x as f64, y as f64).distance(middle) / middle.length().max(0.5);
    (-share * share / (2.0 * sigma * sigma)).exp()
}

/// A surfel after a frame.
#[derive(Clone, Copy, Debug)]
pub struct Absorbed {
    /// With the colour that it had.
    pub surfel: Surfel,
    /// Whether it took up its rival.
    pub merged: bool,
}

/// A surfel after a sample that belongs to it: the mean of all its samples, weighted by their confidences (section 4.2). A sample
/// of a much larger disc only confirms it. A rival near enough, with a normal near enough, becomes part of the mean (section 5.2).
///
/// With a margin above 0 there is no answer where a number that decides lies that near (in metres or radians) to a border.
pub fn absorbed(
    before: &Surfel,
    rival: Option<&Surfel>,
    sample: &Sample,
    measured: &Measured<'_>,
    margin_m: f64,
) -> Option<Absorbed> {
    let settings = measured.settings;
    let (mut point, mut normal) = (before.position.as_dvec3(), before.normal.as_dvec3());
    let mut radius_m = f64::from(before.radius_m);
    let mut confidence = f64::from(before.confidence) + sample.confidence;
    if !above(sample.radius_m, f64::from(settings.coarser) * radius_m, margin_m)? {
        let part = sample.confidence / confidence;
        point = point.lerp(sample.point, part);
        normal = normal.lerp(sample.normal, part);
        radius_m += (sample.radius_m - radius_m) * part;
    }
    let mut merged = false;
    if let Some(rival) = rival {
        let (theirs, their_normal) = (rival.position.as_dvec3(), rival.normal.as_dvec3());
        let cosine = normal.normalize().dot(their_normal);
        merged = !above(theirs.distance(point), settings.merge_m.into(), margin_m)?
            && !above(f64::from(settings.merge_rad).cos(), cosine, margin_m)?;
        if merged {
            let part = f64::from(rival.confidence) / (confidence + f64::from(rival.confidence));
            point = point.lerp(theirs, part);
            normal = normal.lerp(their_normal, part);
            confidence += f64::from(rival.confidence);
        }
    }
    let surfel = Surfel {
        position: point.as_vec3(),
        normal: normal.normalize().as_vec3(),
        radius_m: radius_m as f32,
        submap: before.submap,
        confidence: confidence.min(settings.max_confidence.into()) as f32,
        seen: measured.frame,
        colour: before.colour,
    };
    Some(Absorbed { surfel, merged })
}

/// Whether a pixel's measurement becomes a surfel: it is seen from not too far to the side, no surfel was found for it, and
/// it lies on no disc of the surfels that were found for the pixels around, of those that are not much larger than its own would be.
///
/// `margin_m` (metres; also a cosine) moves every border such that more become surfels; a negative one, less.
pub fn becomes_surfel(
    slots: &[Option<Surfel>],
    association: &Association,
    measured: &Measured<'_>,
    pixel: usize,
    margin_m: f64,
) -> bool {
    let (Some(vertex), Some(normal)) = (measured.vertices.data()[pixel], measured.normals.data()[pixel]) else {
        return false;
    };
    let settings = measured.settings;
    let faces = -vertex.normalize().dot(normal) >= f64::from(settings.max_slant_rad).cos() - margin_m;
    let point = measured.world_from_camera.transform_point(vertex);
    let covers = |surfel: &Surfel| {
        let off = point - surfel.position.as_dvec3();
        let along = off.dot(surfel.normal.as_dvec3());
        let across = (off - along * surfel.normal.as_dvec3()).length();
        let radius_m = f64::from(surfel.radius_m);
        radius_m <= f64::from(settings.finer) * pixel_radius_m(measured, vertex.z) - margin_m
            && along.abs() <= window(settings, vertex.z) - margin_m
            && across <= radius_m * f64::from(settings.reach) - margin_m
    };
    let around = neighbours(measured.camera, pixel);
    let is_covered = around.filter_map(|p| association.chosen[p]).filter_map(|i| slots[i].as_ref()).any(covers);
    faces && association.chosen[pixel].is_none() && !is_covered
}

/// The pixels of the image within one pixel of one, itself included.
fn neighbours(camera: &Intrinsics, pixel: usize) -> impl Iterator<Item = usize> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let (x, y) = (pixel % width, pixel / width);
    let side = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
    side(y, height).flat_map(move |v| side(x, width).map(move |u| v * width + u))
}

/// The surfel that a sample becomes (section 4.1).
pub fn surfel_of(sample: &Sample, colour: Option<[u8; 3]>, submap: u16, frame: u32) -> Surfel {
    Surfel {
        position: sample.point.as_vec3(),
        normal: sample.normal.as_vec3(),
        radius_m: sample.radius_m as f32,
        submap,
        confidence: sample.confidence as f32,
        seen: frame,
        colour,
    }
}

/// The slot of the new surfel of a rank among a frame's: first the free ones in their order, then those behind all others;
/// none where there is no room.
pub fn slot_of(rank: usize, free: &[usize], used: usize, capacity: usize) -> Option<usize> {
    let slot = free.get(rank).copied().unwrap_or_else(|| used + rank - free.len());
    (slot < capacity).then_some(slot)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use itm_core::{Image, Se3, SurfelSettings};

    use super::*;
    use crate::reference::associate::associate;

    #[test]
    fn a_wall_is_averaged_and_needs_no_second_surfel_where_a_disc_lies() {
        let camera = Intrinsics::new(5, 1, 10.0, 10.0, 2.0, 0.0);
        let vertices = Image::from_fn(5, 1, |x, y| Some(camera.unproject(DVec2::new(x.into(), y.into()), 1.0)));
        let normals = Image::filled(5, 1, Some(DVec3::NEG_Z));
        let settings = SurfelSettings::default();
        let measured = Measured {
            camera: &camera,
            world_from_camera: &Se3::IDENTITY,
            depth_range_m: [0.2, 4.0],
            vertices: &vertices,
            normals: &normals,
            settings: &settings,
            frame: 7,
        };
        let middle = sample(&measured, 2).unwrap();
        assert_eq!((middle.point, middle.confidence), (DVec3::Z, 1.0));
        assert!((middle.radius_m - 0.0707).abs() < 1e-4);
        let surfel = surfel_of(&middle, None, 0, 1);
        let before = Surfel { position: Vec3::new(0.0, 0.0, 1.004), confidence: 3.0, radius_m: 0.12, ..surfel };
        let slots = [Some(before)];
        let association = associate(&slots, &measured);
        assert_eq!(association.chosen, [None, None, Some(0), None, None]);
        // A pixel is 0.1 m wide: the disc reaches over its neighbours.
        let new: Vec<_> = (0..5).map(|p| becomes_surfel(&slots, &association, &measured, p, 0.0)).collect();
        assert_eq!(new, [true, false, false, false, true]);
        let after = absorbed(&before, None, &middle, &measured, 0.0).unwrap();
        assert!((after.surfel.position.z - 1.003).abs() < 1e-6 && !after.merged);
        assert_eq!((after.surfel.confidence, after.surfel.seen), (4.0, 7));
        let rival = Surfel { confidence: 12.0, ..surfel };
        let after = absorbed(&before, Some(&rival), &middle, &measured, 0.0).unwrap();
        assert!((after.surfel.position.z - 1.00075).abs() < 1e-6 && after.merged);
        assert_eq!(after.surfel.confidence, 16.0);
        // Seen from too far away, it is only confirmed.
        let fine = Surfel { radius_m: 0.02, ..before };
        let after = absorbed(&fine, None, &middle, &measured, 0.0).unwrap();
        assert_eq!((after.surfel.position.z, after.surfel.confidence), (1.004, 4.0));
    }

    #[test]
    fn free_slots_are_taken_first() {
        let slots: Vec<_> = (0..5).map(|rank| slot_of(rank, &[3, 9], 20, 22)).collect();
        assert_eq!(slots, [Some(3), Some(9), Some(20), Some(21), None]);
    }
}
