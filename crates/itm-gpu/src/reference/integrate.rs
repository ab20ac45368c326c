//! Reference of stage `integrate`: fuses depth, and colour, into the visible blocks (Curless & Levoy 1996, *A Volumetric
//! Method for Building Complex Models from Range Images*; Newcombe et al. 2011, section 3.3; the report, section 3.3).

use glam::{DVec2, DVec3, IVec3};
use itm_core::voxel::{BEST_OBSERVATION, BLOCK_VOXELS, ColourVoxel, DistanceVoxel};
use itm_core::{Calibration, ColourImage, Image, Se3};

use super::map::Map;
use crate::integrate::IntegrateOptions;

/// What is fused.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Metres, 0 where there is none.
    pub depth: &'a Image<f32>,
    /// How much each pixel's depth counts, where not all count one.
    pub weights: Option<&'a Image<u16>>,
    /// Colour, if any.
    pub colour: Option<&'a ColourImage>,
    /// Both cameras.
    pub calibration: &'a Calibration,
    /// Pose of the depth camera.
    pub world_from_camera: &'a Se3,
}

/// Fuses an observation into the voxels of the given blocks, those of them that the map holds.
pub fn integrate(map: &mut Map, visible: &[IVec3], observation: &Observation<'_>, options: &IntegrateOptions) {
    let (voxel_size, truncation) = (f64::from(map.voxel_size_m), f64::from(map.truncation_m));
    for position in visible {
        let Some(block) = map.blocks.get_mut(position) else { continue };
        for at in 0..BLOCK_VOXELS {
            let point_world = voxel_in_map(*position, at).as_dvec3() * voxel_size;
            let Some((pixel, eta)) = signed_distance(observation, point_world) else { continue };
            if eta < -truncation {
                // Hidden behind the surface: nothing is known of it.
                continue;
            }
            let relative = eta / truncation;
            let nearest = (pixel + 0.5).floor();
            let weight = observation.weights.map_or(1, |weights| weights[(nearest.x as u32, nearest.y as u32)]);
            let before = block.distances[at];
            let more = if options.weighted { weight } else { 1 };
            block.distances[at] = fuse_distance(before, relative, more, options);
            block.confidences[at] = fuse_confidence(block.confidences[at], before, relative, weight, options);
            if relative.abs() <= f64::from(options.colour_band)
                && let Some((_, colour)) = observed_colour(observation, point_world)
            {
                block.colours[at] = fuse_colour(block.colours[at], colour, options.max_weight);
            }
        }
    }
}

/// Place in the whole map of a block's voxel.
pub fn voxel_in_map(position: IVec3, index: usize) -> IVec3 {
    let i = index as i32;
    position * 8 + IVec3::new(i & 7, (i >> 3) & 7, i >> 6)
}

/// Where in the depth image a point (world frame, metres) is seen, in pixels, and how far in front of the surface
/// measured there, in metres along the optical axis; `None` where it is not seen or nothing was measured.
///
/// The nearest pixel counts: interpolation would mix foreground and background.
pub fn signed_distance(observation: &Observation<'_>, point_world: DVec3) -> Option<(DVec2, f64)> {
    let point = observation.world_from_camera.inverse().transform_point(point_world);
    let pixel = observation.calibration.depth.project(point)?;
    let nearest = (pixel + 0.5).floor();
    if nearest.min_element() < 0.0 {
        return None;
    }
    let measured = *observation.depth.get(nearest.x as u32, nearest.y as u32)?;
    (measured > 0.0).then(|| (pixel, f64::from(measured) - point.z))
}

/// Where in the colour image a point (world frame, metres) is seen, in pixels, and the colour there between the four
/// pixels around, 0 to 255; `None` where the image lacks one of them, or one has no colour.
pub fn observed_colour(observation: &Observation<'_>, point_world: DVec3) -> Option<(DVec2, DVec3)> {
    let image = observation.colour?;
    let colour_from_world = observation.calibration.colour_from_depth * observation.world_from_camera.inverse();
    let pixel = observation.calibration.colour.project(colour_from_world.transform_point(point_world))?;
    let last = DVec2::new((image.width() - 1).into(), (image.height() - 1).into());
    if pixel.min_element() < 0.0 || pixel.x > last.x || pixel.y > last.y {
        return None;
    }
    let texel = |p: DVec2| {
        let p = p.min(last);
        let [r, g, b, alpha] = image[(p.x as u32, p.y as u32)].map(f64::from);
        (alpha > 0.0).then(|| DVec3::new(r, g, b))
    };
    let base = pixel.floor();
    let f = pixel - base;
    let upper = texel(base)?.lerp(texel(base + DVec2::X)?, f.x);
    let lower = texel(base + DVec2::Y)?.lerp(texel(base + DVec2::ONE)?, f.x);
    Some((pixel, upper.lerp(lower, f.y)))
}

/// A voxel after one more observation of its distance (in truncation bands, positive in front): the running mean, in
/// which this observation counts `more`.
pub fn fuse_distance(voxel: DistanceVoxel, observed: f64, more: u16, options: &IntegrateOptions) -> DistanceVoxel {
    let weight = remaining_weight(voxel, observed, options);
    if options.stop_at_max_weight && weight >= options.max_weight {
        return voxel;
    }
    let old = f64::from(voxel.distance());
    let mean = old + (observed.min(1.0) - old) * f64::from(more) / (f64::from(weight) + f64::from(more));
    DistanceVoxel::new(mean as f32, weight.saturating_add(more).min(options.max_weight))
}

/// What is left of a voxel's weight where it is observed: where it is seen to be empty but claims to be near a surface, what
/// stood there is gone.
fn remaining_weight(voxel: DistanceVoxel, observed: f64, options: &IntegrateOptions) -> u16 {
    let gone = observed >= 1.0 && voxel.distance() < NEARLY_EMPTY;
    voxel.weight().saturating_sub(if gone { options.empty_loss } else { 0 })
}

/// Distances above this claim no surface.
const NEARLY_EMPTY: f32 = 0.95;

/// A voxel's confidence after an observation of its distance that adds so many of the least ones (see
/// [`crate::confidence`]), given the voxel before it.
pub fn fuse_confidence(
    confidence: f32,
    before: DistanceVoxel,
    observed: f64,
    more: u16,
    options: &IntegrateOptions,
) -> f32 {
    let kept = match before.weight() {
        0 => 0.0,
        weight => confidence * f32::from(remaining_weight(before, observed, options)) / f32::from(weight),
    };
    (kept + f32::from(more) / f32::from(BEST_OBSERVATION)).min(options.max_weight.into())
}

/// A voxel after one more observation of its colour (0 to 255): the running mean, rounded to bytes. Where the mean would
/// move by half a step or less, and so might stand still for ever, it moves by one step towards an observation that is at
/// least that far: a running median (McFarlane & Schofield 1995, *Segmentation and Tracking of Piglets in Images*).
pub fn fuse_colour(voxel: ColourVoxel, observed: DVec3, max_weight: u16) -> ColourVoxel {
    let weight = voxel.weight();
    let observed = observed.to_array();
    let fuse = |channel: usize| {
        let old = f64::from(voxel.rgb()[channel]);
        let difference = observed[channel] - old;
        let change = difference / (f64::from(weight) + 1.0);
        // A little over a half, so that rounding does not decide whether a change of exactly a half counts.
        let moved = if change.abs() >= 0.51 {
            old + change
        } else if difference.abs() >= 1.0 {
            old + difference.signum()
        } else {
            old
        };
        moved.round() as u8
    };
    let limit = max_weight.min(255) as u8;
    ColourVoxel::new([fuse(0), fuse(1), fuse(2)], weight.saturating_add(1).min(limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPTIONS: IntegrateOptions = IntegrateOptions {
        max_weight: 4,
        stop_at_max_weight: false,
        colour_band: 0.25,
        empty_loss: 0,
        weighted: false,
    };

    #[test]
    fn a_surface_that_is_seen_through_is_forgotten() {
        let options = IntegrateOptions { max_weight: 100, empty_loss: 10, ..OPTIONS };
        let surface = DistanceVoxel::new(0.1, 30);
        let after = |frames| (0..frames).fold(surface, |voxel, _| fuse_distance(voxel, 1.7, 1, &options));
        assert!(after(4).distance() > 0.9, "{:?}", after(4));
        assert_eq!(fuse_distance(surface, 0.9, 1, &options).weight(), 31, "near a surface nothing is lost");
        let slow = fuse_distance(surface, 1.7, 1, &OPTIONS);
        assert!(slow.distance() < 0.2);
        // Confidence goes with the weight.
        assert!((fuse_confidence(6.0, surface, 1.7, 8, &options) - (4.0 + 0.5)).abs() < 1e-6);
        assert!((fuse_confidence(6.0, surface, 0.2, 8, &options) - 6.5).abs() < 1e-6);
    }

    #[test]
    fn distances_become_their_mean_until_the_weight_is_full() {
        let mut voxel = DistanceVoxel::default();
        for (observed, mean) in [(0.4, 0.4), (0.0, 0.2), (2.0, 1.4 / 3.0)] {
            voxel = fuse_distance(voxel, observed, 1, &OPTIONS);
            assert!((f64::from(voxel.distance()) - mean).abs() < 1e-4);
        }
        for _ in 0..3 {
            voxel = fuse_distance(voxel, 0.0, 1, &OPTIONS);
        }
        assert_eq!(voxel.weight(), 4);
        let stopped = fuse_distance(voxel, 1.0, 1, &IntegrateOptions { stop_at_max_weight: true, ..OPTIONS });
        assert_eq!(stopped, voxel);
        assert_ne!(fuse_distance(voxel, 1.0, 1, &OPTIONS), voxel);
    }

    #[test]
    fn weighted_distances_become_their_weighted_mean() {
        let options = IntegrateOptions { max_weight: 100, ..OPTIONS };
        let mut voxel = DistanceVoxel::default();
        for (observed, weight) in [(0.4, 16), (-0.2, 1), (0.1, 5)] {
            voxel = fuse_distance(voxel, observed, weight, &options);
        }
        let mean = (0.4 * 16.0 - 0.2 + 0.1 * 5.0) / 22.0;
        assert!((f64::from(voxel.distance()) - mean).abs() < 1e-4);
        assert_eq!(voxel.weight(), 22);
    }

    #[test]
    fn colours_follow_a_lasting_change_all_the_way() {
        let mut voxel = ColourVoxel::default();
        for _ in 0..300 {
            voxel = fuse_colour(voxel, DVec3::splat(200.0), 255);
        }
        assert_eq!((voxel.rgb(), voxel.weight()), ([200; 3], 255));
        for _ in 0..600 {
            voxel = fuse_colour(voxel, DVec3::new(210.0, 200.4, 0.0), 255);
        }
        assert_eq!(voxel.rgb(), [210, 200, 0]);
    }
}
