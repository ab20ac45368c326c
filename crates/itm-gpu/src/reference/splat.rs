//! Reference of stage `splat`: surfels as a camera sees them, each as a disc (Keller et al. 2013, *Real-time 3D
//! Reconstruction in Dynamic Scenes using Point-based Fusion*, section 6).

use glam::{DVec2, DVec3};
use itm_core::surfel::{Surfel, confidence_rank};
use itm_core::{Image, Intrinsics, Se3, SurfelSettings};

use crate::reference::associate::window;
use crate::splat::Drawn;

/// Discs seen at less than this cosine from their side are not shown.
pub const LEAST_FACING: f64 = 0.1;
/// Pixels that a disc reaches to each side of its centre at most.
pub const LARGEST_PX: f64 = 12.0;

/// How surfels are looked at.
#[derive(Clone, Copy, Debug)]
pub struct Look<'a> {
    /// The camera.
    pub camera: &'a Intrinsics,
    /// Its pose.
    pub world_from_camera: &'a Se3,
    /// Nearest and farthest depth in metres at which centres of surfels are seen.
    pub depth_range_m: [f32; 2],
    /// The map's settings.
    pub settings: &'a SurfelSettings,
    /// Which surfels are drawn.
    pub drawn: Drawn,
}

/// Depth in metres at which the ray of a pixel meets a surfel's disc, if it does.
///
/// `margin_m` makes discs larger, and moves the other borders (of pixels, cosines) alike; a negative one does the opposite.
pub fn meet(surfel: &Surfel, look: &Look<'_>, pixel: DVec2, margin_m: f64) -> Option<f64> {
    let camera_from_world = look.world_from_camera.inverse();
    let centre = camera_from_world.transform_point(surfel.position.as_dvec3());
    let normal = camera_from_world.transform_vector(surfel.normal.as_dvec3());
    let [near_m, far_m] = look.depth_range_m.map(f64::from);
    let is_recent = surfel.confidence >= look.settings.stable || surfel.seen >= look.drawn.since;
    let is_seen = is_recent
        && surfel.confidence >= look.drawn.least
        && centre.z >= near_m - margin_m
        && centre.z <= far_m + margin_m;
    if !is_seen {
        return None;
    }
    let margin_px = margin_m * look.camera.fx.abs().max(look.camera.fy.abs()) / centre.z;
    let middle = look.camera.project(centre)?;
    if (pixel - middle).abs().max_element() > LARGEST_PX + margin_px {
        return None;
    }
    let ray = look.camera.unproject(pixel, 1.0);
    let facing = normal.dot(ray);
    if facing > (margin_m - LEAST_FACING) * ray.length() {
        return None;
    }
    let z = normal.dot(centre) / facing;
    let radius_m = f64::from(surfel.radius_m * look.drawn.reach) + margin_m;
    (z > 0.0 && (ray * z).distance(centre) <= radius_m).then_some(z)
}

/// For each pixel the slot of the surfel that it shows, and the depth at which it does: of those within a window behind the nearest
/// the best known, and of several of one rank ([`confidence_rank`]) the first. Where any of the confidence that is preferred is met, others are not seen.
pub fn splat(slots: &[Option<Surfel>], look: &Look<'_>) -> Image<Option<(usize, f64)>> {
    Image::from_fn(look.camera.width, look.camera.height, |x, y| {
        let pixel = DVec2::new(x.into(), y.into());
        let met = |(i, surfel): (usize, &Option<Surfel>)| Some((i, meet(surfel.as_ref()?, look, pixel, 0.0)?));
        let mut met: Vec<(usize, f64)> = slots.iter().enumerate().filter_map(met).collect();
        let is_preferred = |i: usize| slots[i].is_some_and(|surfel| surfel.confidence >= look.drawn.preferred);
        if met.iter().any(|(i, _)| is_preferred(*i)) {
            met.retain(|(i, _)| is_preferred(*i));
        }
        let nearest = met.iter().map(|(_, z)| *z).reduce(f64::min)?;
        let rank = |i: usize| slots[i].map_or(0, |surfel| confidence_rank(surfel.confidence));
        met.retain(|(_, z)| *z <= nearest + window(look.settings, nearest));
        met.into_iter().rev().max_by_key(|(i, _)| rank(*i))
    })
}

/// The point (world frame, metres) that a pixel sees at a depth.
pub fn point_at(look: &Look<'_>, pixel: DVec2, z: f64) -> DVec3 {
    look.world_from_camera.transform_point(look.camera.unproject(pixel, z))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn the_best_known_of_those_near_the_nearest_is_shown() {
        let camera = Intrinsics::new(5, 5, 10.0, 10.0, 2.0, 2.0);
        let settings = SurfelSettings::default();
        let look = Look {
            camera: &camera,
            world_from_camera: &Se3::IDENTITY,
            depth_range_m: [0.2, 4.0],
            settings: &settings,
            drawn: Drawn { least: 1.0, preferred: 5.0, since: 0, reach: 1.0 },
        };
        let surfel = |z: f32, confidence: f32| {
            let position = Vec3::new(0.0, 0.0, z);
            Some(Surfel { position, normal: Vec3::NEG_Z, radius_m: 0.12, submap: 0, confidence, seen: 1, colour: None })
        };
        let hidden = surfel(1.5, 9.0);
        let turned_away = surfel(0.7, 9.0).map(|s| Surfel { normal: Vec3::Z, ..s });
        let (unknown, less_known) = (surfel(0.8, 0.5), surfel(0.75, 3.0));
        let slots = [
            hidden,
            None,
            turned_away,
            surfel(1.005, 12.1),
            surfel(1.0, 9.0),
            surfel(1.002, 12.0),
            unknown,
            less_known,
        ];
        let shown = splat(&slots, &look);
        let is_shown = |x, y| shown[(x, y)].map(|(i, _)| i);
        assert_eq!([(2, 2), (1, 2), (2, 3)].map(|(x, y)| is_shown(x, y)), [Some(3); 3]);
        // Beside the discs that are well known there is one of the less known, which is nearer and looks larger.
        assert_eq!([(1, 1), (0, 2)].map(|(x, y)| is_shown(x, y)), [Some(7), None]);
        assert!((shown[(2, 2)].unwrap().1 - 1.005).abs() < 1e-6);
        let slots = [surfel(1.5, 3.0), unknown, less_known];
        assert_eq!(splat(&slots, &look)[(2, 2)].map(|(i, _)| i), Some(2));
    }
}
