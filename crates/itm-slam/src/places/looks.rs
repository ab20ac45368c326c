//! How places are looked at: what is tracked there, and with which camera.

use itm_core::{Intrinsics, Settings, TrackerKind};

/// Levels of the depth pyramid that are tracked on.
const LEVELS: u32 = 4;

/// Of depth alone: a candidate's place has no frame before whose colours could be compared.
fn depth_settings(settings: &Settings, finest: u32) -> Settings {
    let mut depth_alone = settings.clone();
    depth_alone.tracker.kind = TrackerKind::Extended;
    let extended = &mut depth_alone.tracker.extended;
    extended.use_depth = true;
    extended.use_colour = false;
    extended.use_map_colour = false;
    // Not turning alone, and from further away than between frames.
    extended.levels = (0..LEVELS).rev().map(|level| if level >= finest { 'b' } else { 'n' }).collect();
    extended.max_plane_distance_coarse_m = settings.relocaliser.max_plane_distance_m;
    depth_alone
}

/// For tracking in full, down to a level from [`trial_level`].
pub(super) fn trial_settings(settings: &Settings, finest: u32) -> Settings {
    let mut trial = depth_settings(settings, finest);
    let extended = &mut trial.tracker.extended;
    // What ends on a coarser level is judged as strictly as what ends on the finest: distances are interpolated geometrically
    // over all levels, of which the finest are left out.
    let (coarse, used) = (extended.max_plane_distance_coarse_m, LEVELS - 1 - finest);
    let narrower = extended.max_plane_distance_fine_m / coarse;
    extended.max_plane_distance_fine_m = coarse * narrower.powf((LEVELS - 1) as f32 / used as f32);
    trial
}

/// For the two coarsest levels alone.
pub(super) fn glance_settings(settings: &Settings) -> Settings {
    depth_settings(settings, LEVELS - 2)
}

/// The finest level that is tracked on in full: not wider than so many pixels, unless it is the one above the coarsest.
pub(super) fn trial_level(camera: &Intrinsics, width: u32) -> u32 {
    level_of_width(camera, width).min(LEVELS - 2)
}

/// The first level of a camera's pyramid that is not wider than so many pixels, or the coarsest.
fn level_of_width(camera: &Intrinsics, width: u32) -> u32 {
    (0..LEVELS - 1).find(|level| camera.at_level(*level).width <= width).unwrap_or(LEVELS - 1)
}

/// A camera that sees so many times as much to all sides, with an image of a level not wider than so many pixels.
pub(super) fn wide(camera: &Intrinsics, width: u32, widening: f64) -> Intrinsics {
    let small = camera.at_level(level_of_width(camera, width));
    Intrinsics { fx: small.fx / widening, fy: small.fy / widening, ..small }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::{Age, Tracker};

    #[test]
    fn images_are_as_wide_as_the_settings_allow() {
        let camera = |width| Intrinsics::new(width, width * 3 / 4, 500.0, 500.0, 160.0, 120.0);
        for (width, finest) in [(160, 0), (320, 0), (321, 1), (640, 1), (1280, 2), (16000, 3)] {
            assert_eq!(level_of_width(&camera(width), 320), finest, "{width}");
        }
        assert_eq!(trial_level(&camera(16000), 320), 2);
        let (narrow, wide) = (camera(640).at_level(2), wide(&camera(640), 160, 2.0));
        assert_eq!((wide.width, wide.height, wide.fx), (narrow.width, narrow.height, 0.5 * narrow.fx));
    }

    #[test]
    fn what_ends_on_a_coarser_level_is_judged_as_on_the_finest() {
        let settings = Settings::default();
        for finest in 0..3 {
            let tracker = Tracker::new(
                &trial_settings(&settings, finest),
                &Intrinsics::new(640, 480, 500.0, 500.0, 320.0, 240.0),
            );
            let plans = tracker.expect("settings that can be used").plans(Age::default());
            let levels: Vec<_> = plans[0].levels.iter().map(|level| level.request).collect();
            let (first, last) = (levels[0], levels[levels.len() - 1]);
            assert_eq!((first.level, last.level), (3, finest as usize));
            let limits = [first, last].map(|request| request.depth.expect("depth alone").max_plane_distance_m);
            let expected =
                [settings.relocaliser.max_plane_distance_m, settings.tracker.extended.max_plane_distance_fine_m];
            assert!(limits.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{limits:?}");
        }
    }
}
