//! Reference of stage `associate`: which surfel each measurement of a view belongs to (Keller et al. 2013, *Real-time 3D
//! Reconstruction in Dynamic Scenes using Point-based Fusion*, sections 4.2 and 5).

use glam::{DVec2, DVec3};
use itm_core::surfel::{Surfel, confidence_rank};
use itm_core::{Calibration, ColourImage, Image, Intrinsics, Se3, SurfelSettings};

/// A frame's measurements, and how they were taken.
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    /// The depth camera.
    pub camera: &'a Intrinsics,
    /// Its pose.
    pub world_from_camera: &'a Se3,
    /// Nearest and farthest depth in metres at which surfels are seen.
    pub depth_range_m: [f32; 2],
    /// Camera frame, metres.
    pub vertices: &'a Image<Option<DVec3>>,
    /// Camera frame, towards the camera.
    pub normals: &'a Image<Option<DVec3>>,
    /// The map's settings.
    pub settings: &'a SurfelSettings,
    /// The frame's number.
    pub frame: u32,
}

/// Frames from one that removes what was not seen for long to the next.
pub const FORGETS_EVERY: u32 = 16;

/// What a surfel is to a frame. Pixels are numbered row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// No measurement says anything of it.
    None,
    /// It stayed unstable, and was not seen for long.
    Forgotten,
    /// This pixel looks at it, and measures something else that does not stand before it.
    Refuted(usize),
    /// It may be the surfel of this pixel's measurement.
    Competes(usize),
    /// It stands in front of what this pixel measures.
    InFront(usize),
}

/// What each surfel is to a frame, by its place alone (section 4.2: a window of depth and an angle between the normals;
/// section 5.3: unstable for too long, or in free space).
///
/// With a margin above 0 there is no answer where a number that decides lies that near (in metres; in radians; in the pixels that
/// so many metres are there) to a border.
pub fn role(surfel: &Surfel, measured: &Measured<'_>, margin_m: f64) -> Option<Role> {
    let settings = measured.settings;
    let unseen = measured.frame.saturating_sub(surfel.seen);
    // Which takes a look at most of the map: now and then.
    if measured.frame.is_multiple_of(FORGETS_EVERY)
        && surfel.confidence < settings.stable
        && unseen > settings.forget_after
    {
        return Some(Role::Forgotten);
    }
    let camera_from_world = measured.world_from_camera.inverse();
    let centre = camera_from_world.transform_point(surfel.position.as_dvec3());
    let [near_m, far_m] = measured.depth_range_m.map(f64::from);
    if above(near_m, centre.z, margin_m)? || above(centre.z, far_m, margin_m)? {
        return Some(Role::None);
    }
    let Some(pixel) = pixel_of(measured.camera, centre, margin_m)? else { return Some(Role::None) };
    let Some(vertex) = measured.vertices.data()[pixel] else { return Some(Role::None) };
    let in_front = vertex.z - centre.z;
    let deviation = depth_deviation(vertex.z);
    if above(in_front, f64::from(settings.free_m) + f64::from(settings.free_deviations) * deviation, margin_m)? {
        return Some(Role::InFront(pixel));
    }
    let Some(normal) = measured.normals.data()[pixel] else { return Some(Role::None) };
    let cosine = normal.dot(camera_from_world.transform_vector(surfel.normal.as_dvec3()));
    let is_behind = above(-in_front, window(settings, vertex.z), margin_m)?;
    let is_off = is_behind
        || above(in_front, window(settings, vertex.z), margin_m)?
        || above(f64::from(settings.max_angle_rad).cos(), cosine, margin_m)?;
    Some(match (is_off, is_behind) {
        (false, _) => Role::Competes(pixel),
        (true, false) => Role::Refuted(pixel),
        (true, true) => Role::None,
    })
}

/// What a frame's measurements and the surfels are to each other. Surfels by their slots.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Association {
    /// For each pixel the surfel that its measurement belongs to: of those that compete the best known one
    /// (section 5.2), and of several of one rank ([`confidence_rank`]) the first.
    pub chosen: Vec<Option<usize>>,
    /// For each pixel the first of the stable surfels that competed as well: it may be merged (section 5.2).
    pub rivals: Vec<Option<usize>>,
    /// Surfels that stand in front of a measurement whose surfel has a stable one's rank, that stayed unstable though they are looked at,
    /// and what was not seen for long (section 5.3).
    pub removed: Vec<usize>,
}

/// Associates surfels, some slots being empty, with a frame's measurements.
pub fn associate(slots: &[Option<Surfel>], measured: &Measured<'_>) -> Association {
    let known = || slots.iter().enumerate().filter_map(|(i, surfel)| surfel.as_ref().map(|surfel| (i, surfel)));
    let roles: Vec<(usize, &Surfel, Role)> =
        known().map(|(i, surfel)| (i, surfel, role(surfel, measured, 0.0).unwrap_or(Role::None))).collect();
    let rank = |i: usize| slots[i].map_or(0, |surfel| confidence_rank(surfel.confidence));
    let mut chosen: Vec<Option<usize>> = vec![None; measured.camera.pixels()];
    for (i, surfel, role) in &roles {
        if let Role::Competes(pixel) = role {
            let held = &mut chosen[*pixel];
            if held.is_none_or(|held| confidence_rank(surfel.confidence) > rank(held)) {
                *held = Some(*i);
            }
        }
    }
    let mut rivals: Vec<Option<usize>> = vec![None; chosen.len()];
    for (i, surfel, role) in &roles {
        if let Role::Competes(pixel) = role
            && chosen[*pixel] != Some(*i)
            && surfel.confidence >= measured.settings.stable
        {
            rivals[*pixel].get_or_insert(*i);
        }
    }
    let least = confidence_rank(measured.settings.stable);
    let is_stable = |pixel: usize| chosen[pixel].is_some_and(|i| rank(i) >= least);
    let is_removed = |(i, surfel, role): &&(usize, &Surfel, Role)| match role {
        Role::Forgotten => true,
        Role::InFront(pixel) => is_stable(*pixel) || is_old(surfel, measured),
        Role::Refuted(_) => is_old(surfel, measured),
        Role::Competes(pixel) => chosen[*pixel] != Some(*i) && is_old(surfel, measured),
        Role::None => false,
    };
    let removed = roles.iter().filter(is_removed).map(|(i, ..)| *i).collect();
    Association { chosen, rivals, removed }
}

/// Whether a surfel is unstable, and was not observed for a while.
pub fn is_old(surfel: &Surfel, measured: &Measured<'_>) -> bool {
    let settings = measured.settings;
    surfel.confidence < settings.stable && measured.frame.saturating_sub(surfel.seen) > settings.patience
}

/// The colour of a measurement (camera frame, metres), where the colour camera sees it: bilinear between the four pixels around, of
/// which each needs a colour. A margin makes the image larger.
pub fn colour_of(vertex: DVec3, image: &ColourImage, calibration: &Calibration, margin_px: f64) -> Option<[u8; 3]> {
    let pixel = calibration.colour.project(calibration.colour_from_depth.transform_point(vertex))?;
    let last = DVec2::new((image.width() - 1).into(), (image.height() - 1).into());
    if pixel.cmplt(DVec2::splat(-margin_px)).any() || pixel.cmpgt(last + margin_px).any() {
        return None;
    }
    let at = pixel.clamp(DVec2::ZERO, last);
    let base = at.floor();
    let f = at - base;
    let texel = |offset: DVec2| {
        let p = (base + offset).min(last);
        let [r, g, b, alpha] = image[(p.x as u32, p.y as u32)].map(f64::from);
        (alpha > 0.0).then(|| DVec3::new(r, g, b))
    };
    let upper = texel(DVec2::ZERO)?.lerp(texel(DVec2::X)?, f.x);
    let lower = texel(DVec2::Y)?.lerp(texel(DVec2::ONE)?, f.x);
    Some(upper.lerp(lower, f.y).round().to_array().map(|v| v as u8))
}

/// Largest difference in depth, in metres, between a measurement at a depth and its surfel.
pub fn window(settings: &SurfelSettings, z: f64) -> f64 {
    f64::from(settings.window_m) + f64::from(settings.window_deviations) * depth_deviation(z)
}

/// A Kinect's standard deviation of depth in metres (Nguyen et al. 2012, *Modeling Kinect Sensor Noise for Improved 3D
/// Reconstruction and Tracking*), from 0.4 m on.
pub(crate) fn depth_deviation(z: f64) -> f64 {
    0.0012 + 0.0019 * (z - 0.4).max(0.0).powi(2)
}

/// The pixel whose square a point in front of the camera (camera frame) falls into, if any.
#[expect(clippy::option_option, reason = "no answer, or that there is no such pixel")]
fn pixel_of(camera: &Intrinsics, point: DVec3, margin_m: f64) -> Option<Option<usize>> {
    let Some(pixel) = camera.project(point) else { return Some(None) };
    let margin_px = margin_m * camera.fx.abs().max(camera.fy.abs()) / point.z;
    let position = pixel + 0.5;
    if margin_m > 0.0 && (position - position.round()).abs().min_element() < margin_px {
        return None;
    }
    let size = DVec2::new(camera.width.into(), camera.height.into());
    let is_inside = position.cmpge(DVec2::ZERO).all() && position.cmplt(size).all();
    Some(is_inside.then(|| position.y as usize * camera.width as usize + position.x as usize))
}

/// Whether a number is above a limit. With a margin above 0 there is no answer where it is that near.
pub(crate) fn above(value: f64, limit: f64, margin: f64) -> Option<bool> {
    (margin <= 0.0 || (value - limit).abs() > margin).then_some(value > limit)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// A surfel straight ahead, facing the camera.
    fn surfel(z: f32, confidence: f32, seen: u32) -> Option<Surfel> {
        let position = Vec3::new(0.0, 0.0, z);
        Some(Surfel { position, normal: Vec3::NEG_Z, radius_m: 0.01, submap: 0, confidence, seen, colour: None })
    }

    #[test]
    fn the_best_known_wins_and_what_stands_in_front_goes() {
        let camera = Intrinsics::new(3, 3, 10.0, 10.0, 1.0, 1.0);
        let vertices = Image::from_fn(3, 3, |x, y| Some(camera.unproject(DVec2::new(x.into(), y.into()), 1.0)));
        let normals = Image::filled(3, 3, Some(DVec3::NEG_Z));
        let settings = SurfelSettings { patience: 20, ..SurfelSettings::default() };
        let measured = Measured {
            camera: &camera,
            world_from_camera: &Se3::IDENTITY,
            depth_range_m: [0.2, 4.0],
            vertices: &vertices,
            normals: &normals,
            settings: &settings,
            frame: 50,
        };
        let turned = surfel(1.0, 99.0, 50).map(|s| Surfel { normal: Vec3::X, ..s });
        let slots = [
            surfel(1.001, 12.0, 1),
            None,
            surfel(0.999, 20.0, 1),
            surfel(1.002, 20.0, 50),
            surfel(0.7, 11.0, 50),
            surfel(1.0, 1.0, 29),
            surfel(1.5, 99.0, 50),
            turned,
        ];
        let found = associate(&slots, &measured);
        let only_middle = |i| (0..9).map(|pixel| (pixel == 4).then_some(i)).collect::<Vec<_>>();
        let expected = Association { chosen: only_middle(2), rivals: only_middle(0), removed: vec![4, 5] };
        assert_eq!(found, expected);
        // Without a stable surface behind it nothing is known to be free.
        let found = associate(&[surfel(1.0, 9.0, 50), surfel(0.7, 11.0, 50)], &measured);
        assert_eq!((found.removed, found.chosen[4]), (vec![], Some(0)));
    }
}
