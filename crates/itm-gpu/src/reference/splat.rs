//! Reference of stage `splat`: surfels as a camera sees them, each as a disc (Keller et al. 2013, *Real-time 3D
//! Reconstruction in Dynamic Scenes using Point-based Fusion*, section 6).

use std::collections::BTreeMap;

use glam::{DVec2, DVec3, IVec2, UVec2};
use itm_core::surfel::{Surfel, confidence_rank};
use itm_core::{Image, Intrinsics, Se3, SurfelSettings};

use crate::reference::associate::window;
use crate::splat::Drawn;

/// Discs seen at less than this cosine from their side are not shown.
pub const LEAST_FACING: f64 = 0.1;
/// Pixels that a disc reaches to each side of its centre at most.
pub const LARGEST_PX: f64 = 12.0;

/// Cells to each side of the image in which surfels compete too.
pub const BORDER: i32 = LARGEST_PX as i32 + 1;

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

impl Look<'_> {
    /// A surfel's centre and normal, camera frame.
    fn place(&self, surfel: &Surfel) -> (DVec3, DVec3) {
        let camera_from_world = self.world_from_camera.inverse();
        let centre = camera_from_world.transform_point(surfel.position.as_dvec3());
        (centre, camera_from_world.transform_vector(surfel.normal.as_dvec3()))
    }

    /// Whether a surfel with its centre at a depth is drawn at all.
    fn is_drawn(&self, surfel: &Surfel, z: f64, margin_m: f64) -> bool {
        let [near_m, far_m] = self.depth_range_m.map(f64::from);
        let is_recent = surfel.confidence >= self.settings.stable || surfel.seen >= self.drawn.since;
        is_recent && surfel.confidence >= self.drawn.least && z >= near_m - margin_m && z <= far_m + margin_m
    }
}

/// Depth in metres at which the ray of a pixel meets a surfel's disc, of so many times its radius, if it does.
///
/// `margin_m` makes discs larger, and moves the other borders (of pixels, cosines) alike; a negative one does the opposite.
pub fn meet(surfel: &Surfel, look: &Look<'_>, pixel: DVec2, times: f64, margin_m: f64) -> Option<f64> {
    let (centre, normal) = look.place(surfel);
    if !look.is_drawn(surfel, centre.z, margin_m) {
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
    // None is smaller than what a pixel sees of a surface.
    let focal = f64::midpoint(look.camera.fx.abs(), look.camera.fy.abs());
    let least_m = std::f64::consts::FRAC_1_SQRT_2 / focal * centre.z / normal.z.abs().max(0.26);
    let radius_m = times * f64::from(surfel.radius_m * look.drawn.reach).max(least_m) + margin_m;
    (z > 0.0 && (ray * z).distance(centre) <= radius_m).then_some(z)
}

/// The cell, of the size of a pixel, that a surfel's centre lies in, and its depth, if it may be drawn. All centres are moved by a part of a pixel.
fn cell(surfel: &Surfel, look: &Look<'_>, moved: DVec2, margin_m: f64) -> Option<(IVec2, f64)> {
    let (centre, normal) = look.place(surfel);
    let cell = (look.camera.project(centre)? + moved + 0.5).floor().as_ivec2();
    let size = IVec2::new(look.camera.width as i32, look.camera.height as i32);
    let is_near = cell.cmpge(IVec2::splat(-BORDER)).all() && cell.cmplt(size + BORDER).all();
    let faces = normal.dot(centre) <= (margin_m - LEAST_FACING) * centre.length();
    (is_near && faces && look.is_drawn(surfel, centre.z, margin_m)).then_some((cell, centre.z))
}

/// Of some that are met at depths the one that is chosen: of those that are preferred, if there are any, and no deeper than within a window behind the nearest
/// of these the best known ([`confidence_rank`]), and of several alike the first.
fn choose(slots: &[Option<Surfel>], look: &Look<'_>, met: &[(usize, f64)], margin_m: f64) -> Option<(usize, f64)> {
    let is_preferred = |i: usize| slots[i].is_some_and(|surfel| surfel.confidence >= look.drawn.preferred);
    let any = met.iter().any(|(i, _)| is_preferred(*i));
    let alike = || met.iter().filter(|(i, _)| is_preferred(*i) == any);
    let nearest = alike().map(|(_, z)| *z).reduce(f64::min)?;
    let last = nearest + window(look.settings, nearest) + margin_m;
    let rank = |i: usize| slots[i].map_or(0, |surfel| confidence_rank(surfel.confidence));
    alike().filter(|(_, z)| *z <= last).rev().max_by_key(|(i, _)| rank(*i)).copied()
}

/// The slots whose discs are drawn, with their cells, in the order of these, row by row: each cell chooses one.
///
/// All centres are moved by a part of a pixel, and other borders by a margin, for those who want to know what roundings may change.
pub fn kept(slots: &[Option<Surfel>], look: &Look<'_>, moved: DVec2, margin_m: f64) -> Vec<(usize, IVec2)> {
    let mut cells: BTreeMap<[i32; 2], Vec<(usize, f64)>> = BTreeMap::new();
    for (i, surfel) in slots.iter().enumerate() {
        if let Some((cell, z)) = surfel.as_ref().and_then(|surfel| cell(surfel, look, moved, margin_m)) {
            cells.entry([cell.y, cell.x]).or_default().push((i, z));
        }
    }
    let chosen =
        cells.iter().filter_map(|([y, x], met)| Some((choose(slots, look, met, margin_m)?.0, IVec2::new(*x, *y))));
    chosen.collect()
}

/// The discs of some that a pixel may show, and their depths: those that it meets, and where there are none, of the cells around it those that it meets within [`Drawn::fill`] of
/// their radii.
pub fn met(
    slots: &[Option<Surfel>],
    look: &Look<'_>,
    kept: &[(usize, IVec2)],
    pixel: UVec2,
    margin_m: f64,
) -> Vec<(usize, f64)> {
    let within = |times: f64| {
        let near = move |cell: IVec2| times == 1.0 || (cell - pixel.as_ivec2()).abs().max_element() <= 1;
        let meet = move |i: usize| meet(slots[i].as_ref()?, look, pixel.as_dvec2(), times, margin_m);
        let met = kept.iter().filter(move |(_, cell)| near(*cell)).filter_map(move |(i, _)| Some((*i, meet(*i)?)));
        met.collect::<Vec<_>>()
    };
    Some(within(1.0)).filter(|met| !met.is_empty()).unwrap_or_else(|| within(look.drawn.fill.into()))
}

/// For each pixel the slot of the surfel that it shows, and the depth at which it does: of the discs that are [`kept`] it chooses one of those that are [`met`].
/// Where any of the confidence that is preferred is met, others are not seen.
pub fn splat(slots: &[Option<Surfel>], look: &Look<'_>) -> Image<Option<(usize, f64)>> {
    let kept = kept(slots, look, DVec2::ZERO, 0.0);
    Image::from_fn(look.camera.width, look.camera.height, |x, y| {
        choose(slots, look, &met(slots, look, &kept, UVec2::new(x, y), 0.0), 0.0)
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
            drawn: Drawn { least: 1.0, preferred: 5.0, since: 0, reach: 1.0, fill: 3.0 },
        };
        let surfel = |z: f32, confidence: f32| {
            let position = Vec3::new(0.0, 0.0, z);
            Some(Surfel { position, normal: Vec3::NEG_Z, radius_m: 0.12, submap: 0, confidence, seen: 1, colour: None })
        };
        let hidden = surfel(1.5, 9.0);
        let turned_away = surfel(0.7, 9.0).map(|s| Surfel { normal: Vec3::Z, ..s });
        let (unknown, less_known) = (surfel(0.8, 0.5), surfel(0.75, 3.0));
        let beside = less_known.map(|s| Surfel { position: Vec3::new(-0.075, -0.075, 0.75), ..s });
        let slots = [
            hidden,
            None,
            turned_away,
            surfel(1.005, 12.1),
            surfel(1.0, 9.0),
            surfel(1.002, 12.0),
            unknown,
            less_known,
            beside,
        ];
        let shown = splat(&slots, &look);
        let is_shown = |x, y| shown[(x, y)].map(|(i, _)| i);
        assert_eq!([(2, 2), (1, 2), (2, 3)].map(|(x, y)| is_shown(x, y)), [Some(3); 3]);
        // Beside the discs that are well known there is one of the less known, which is nearer. That in their own cell is not drawn.
        assert_eq!([(1, 1), (0, 2)].map(|(x, y)| is_shown(x, y)), [Some(8); 2]);
        // What meets no disc shows one of the cells around.
        assert_eq!([(3, 3), (4, 4)].map(|(x, y)| is_shown(x, y)), [Some(3), None]);
        assert!((shown[(3, 3)].unwrap().1 - 1.005).abs() < 1e-6);
        assert!((shown[(2, 2)].unwrap().1 - 1.005).abs() < 1e-6);
        let slots = [surfel(1.5, 3.0), unknown, less_known];
        assert_eq!(splat(&slots, &look)[(2, 2)].map(|(i, _)| i), Some(2));
    }
}
