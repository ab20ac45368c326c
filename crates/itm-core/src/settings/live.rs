//! Which settings a running session can take over, and which wait for the next one.

use serde::Deserialize as _;

use super::{Settings, SettingsError};

/// Keys of settings, or of whole groups of them, that take effect at once in a running session.
///
/// They are read anew each time that they are needed. Everything else is built into what a session makes at its start:
/// buffers and their sizes, pyramids, the kind of the map, files that are open.
pub const LIVE_SETTINGS: &[&str] = &[
    "view.colour_times",
    "view.colour_delay_s",
    "map.max_weight",
    "map.stop_at_max_weight",
    "map.colour_band",
    "map.fuse",
    "tracker.predict_motion",
    "tracker.hold_degenerate",
    "tracker.min_information",
    "tracker.on_failure",
    // But for the levels, from which it follows what else is computed of a frame.
    "tracker.icp.max_steps_coarse",
    "tracker.icp.max_steps_fine",
    "tracker.icp.max_distance_coarse_m",
    "tracker.icp.max_distance_fine_m",
    "tracker.icp.min_step",
    "tracker.icp.max_rms_mm",
    // Nor what is compared, for which points are listed.
    "tracker.extended.colour_weight",
    "tracker.extended.enough_information",
    "tracker.extended.estimate_exposure",
    "tracker.extended.max_steps_coarse",
    "tracker.extended.max_steps_fine",
    "tracker.extended.min_step",
    "tracker.extended.max_plane_distance_coarse_m",
    "tracker.extended.max_plane_distance_fine_m",
    "tracker.extended.huber_share",
    "tracker.extended.depth_weight",
    "tracker.extended.max_colour_difference_coarse",
    "tracker.extended.max_colour_difference_fine",
    "tracker.extended.tukey_cutoff",
    "tracker.extended.min_colour_gradient",
    "tracker.extended.frames_to_skip",
    "tracker.extended.frames_to_weight",
    "tracker.extended.full_confidence",
    "tracker.extended.min_pairs",
    "tracker.extended.max_rms_mm",
    "tracker.rgb.max_steps",
    "tracker.rgb.min_step",
    "tracker.rgb.min_decrease",
    "tracker.rgb.max_difference",
    "tracker.imu.camera_from_imu",
    "tracker.imu.gyroscope_bias",
    "tracker.forward_projection.max_frames",
    "tracker.forward_projection.max_move_m",
    "tracker.verdict",
    // How places are looked for, but not how keyframes are chosen and coded, nor the images that the map is cast into.
    "relocaliser.candidates",
    "relocaliser.apart_m",
    "relocaliser.apart_rad",
    "relocaliser.reach_m",
    "relocaliser.reach_rad",
    "relocaliser.searched",
    "relocaliser.at_once",
    "relocaliser.refined",
    "relocaliser.followed_up",
    "relocaliser.rivals_within",
    "relocaliser.same_within_m",
    "relocaliser.same_within_rad",
    "relocaliser.max_plane_distance_m",
    "relocaliser.rounds",
    "relocaliser.cast_within_m",
    "relocaliser.cast_within_rad",
    "relocaliser.max_chance_wrong",
    "relocaliser.min_inlier_share",
    "relocaliser.average_of",
    "relocaliser.average_within_m",
    "relocaliser.average_within_rad",
    "submaps",
    "surfels.radius_factor",
    "surfels.confidence_sigma",
    "surfels.stable",
    "surfels.max_confidence",
    "surfels.patience",
    "surfels.track_from",
    "surfels.all_for",
    "surfels.window_m",
    "surfels.window_deviations",
    "surfels.max_angle_rad",
    "surfels.max_slant_rad",
    "surfels.coarser",
    "surfels.finer",
    "surfels.reach",
    "surfels.overlap",
    "surfels.merge_m",
    "surfels.merge_rad",
    "surfels.free_m",
    "surfels.free_deviations",
    // But for the cells, and how often they are gone over.
    "surfels.dynamics.gate_m",
    "surfels.dynamics.gate_deviations",
    "surfels.dynamics.min_share",
    "surfels.dynamics.alike_m",
    "surfels.dynamics.alike_deviations",
    "surfels.dynamics.alike_rad",
    "surfels.dynamics.fallen",
];

impl Settings {
    /// Whether a setting, by its full key, takes effect at once in a running session; see [`LIVE_SETTINGS`].
    pub fn is_live(key: &str) -> bool {
        LIVE_SETTINGS
            .iter()
            .any(|live| key.strip_prefix(live).is_some_and(|rest| rest.is_empty() || rest.starts_with('.')))
    }

    /// These settings, with those of `wanted` that take effect at once in a running session, and the full keys of the
    /// others that differ, sorted: they need another session.
    ///
    /// # Errors
    /// Where `wanted` cannot be used, or the part of it that takes effect at once cannot be used with the rest as it is.
    pub fn with_live(&self, wanted: &Self) -> Result<(Self, Vec<String>), SettingsError> {
        wanted.validate()?;
        let (mut tree, mut others) = (tree_of(self), Vec::new());
        take_over(&mut tree, &tree_of(wanted), "", &mut others);
        others.sort();
        let settings = Self::deserialize(tree).expect("both trees are of settings");
        settings.validate()?;
        Ok((settings, others))
    }
}

fn tree_of(settings: &Settings) -> toml::Table {
    toml::Table::try_from(settings).expect("settings are tables of numbers, strings and switches")
}

/// Takes over what takes effect at once, and notes what else differs.
fn take_over(tree: &mut toml::Table, wanted: &toml::Table, group: &str, others: &mut Vec<String>) {
    for (name, wanted) in wanted {
        let key = if group.is_empty() { name.clone() } else { format!("{group}.{name}") };
        match (tree.get_mut(name), wanted) {
            (Some(toml::Value::Table(tree)), toml::Value::Table(wanted)) => take_over(tree, wanted, &key, others),
            (Some(value), wanted) if value == wanted => {}
            (_, wanted) if Settings::is_live(&key) => {
                tree.insert(name.clone(), wanted.clone());
            }
            _ => others.push(key),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(overrides: &[&str]) -> Settings {
        let overrides: Vec<String> = overrides.iter().map(|given| (*given).into()).collect();
        Settings::resolve(None, &overrides).unwrap()
    }

    #[test]
    fn every_live_key_is_one_of_the_tree_and_stands_once() {
        let tree = toml::Value::Table(tree_of(&Settings::default()));
        for (at, live) in LIVE_SETTINGS.iter().enumerate() {
            assert!(live.split('.').try_fold(&tree, |tree, name| tree.get(name)).is_some(), "{live}");
            assert!(!LIVE_SETTINGS[..at].contains(live), "{live} stands twice");
        }
    }

    #[test]
    fn a_key_is_live_with_all_of_its_group_but_not_with_another_that_begins_alike() {
        assert!(Settings::is_live("map.fuse") && Settings::is_live("submaps.close_loops"));
        assert!(!Settings::is_live("map.fused") && !Settings::is_live("map") && !Settings::is_live("mode"));
    }

    #[test]
    fn live_settings_are_taken_over_and_the_others_named_and_left() {
        let before = settings(&["map.voxel_size_m=0.01", "tracker.verdict.frames_to_recover=7"]);
        let wanted = settings(&[
            "mode=surfels",
            "map.fuse=false",
            "submaps.close_loops=false",
            "tracker.on_failure=ignore",
            "tracker.composite.trackers=['type=rgb']",
        ]);
        let (settings, others) = before.with_live(&wanted).unwrap();
        assert_eq!(others, ["map.voxel_size_m", "mode", "tracker.composite.trackers"]);
        let mut expected = wanted.clone();
        expected.mode = before.mode;
        expected.map.voxel_size_m = before.map.voxel_size_m;
        expected.tracker.composite.trackers = before.tracker.composite.trackers.clone();
        assert_eq!(settings, expected);
        assert_eq!(settings.with_live(&settings), Ok((settings.clone(), Vec::new())));
    }

    #[test]
    fn what_cannot_be_used_is_refused_as_is_what_cannot_be_used_with_the_rest() {
        let mut wrong = Settings::default();
        wrong.map.colour_band = 2.0;
        let refused = |before: &Settings, wanted: &Settings| match before.with_live(wanted) {
            Err(SettingsError::Value { key, .. }) => key,
            other => panic!("{other:?}"),
        };
        assert_eq!(refused(&Settings::default(), &wrong), "map.colour_band");
        let (before, wanted) =
            (settings(&["surfels.dynamics.enabled=true"]), settings(&["surfels.dynamics.fallen=99.0"]));
        assert_eq!(refused(&before, &wanted), "surfels.dynamics.fallen");
    }
}
