//! How a place is found again.

use serde::{Deserialize, Serialize};

use super::{SettingsError, check, in_range};

/// How a place is found again, after a loss of tracking or to close a loop: among keyframes, by what they look like.
///
/// The defaults are those for closing loops (Kähler et al. 2016). Half the ferns and a `min_dissimilarity` of 0.2 find the
/// camera after a loss in one map (the report), from fewer keyframes.
///
/// How many frames must be good before fusion goes on stands in `tracker.verdict.frames_to_recover`, for a loss may also end
/// without the relocaliser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct RelocaliserSettings {
    /// Which relocaliser.
    pub kind: RelocaliserKind,
    /// Which images are compared.
    pub image: RelocaliserImage,
    /// Width in pixels of the small image that is compared, at most 512.
    pub width: u32,
    /// Its height in pixels, at most 512.
    pub height: u32,
    /// Standard deviation of the Gaussian that smooths it, in pixels of the small image, so that the outcome does not depend
    /// on the sensor's resolution; 0 for none.
    pub smoothing_px: f32,
    /// Number of ferns, at most 16384. Time and memory grow with it.
    pub ferns: u32,
    /// Tests in each fern, 1 to 8. With more of them, two views agree in fewer ferns.
    pub tests: u32,
    /// What the ferns are drawn from. Keyframes can only be compared where it was the same.
    pub seed: u32,
    /// A frame becomes a keyframe where its dissimilarity from every keyframe of its place is above this, 0 to 1: the share of
    /// ferns whose codes differ.
    pub min_dissimilarity: f64,
    /// A keyframe is of a frame's place where it is in the same submap and within this many metres of it.
    pub place_within_m: f64,
    /// The same, for the angle between them in radians.
    pub place_within_rad: f64,
    /// Places that are tried after a loss, those that the most similar keyframes tell of, 1 to 1000.
    pub candidates: u32,
    /// Places within this many metres and `apart_rad` of a likelier one are left out, so that those that are tried are different.
    pub apart_m: f64,
    /// The same, for the angle between them in radians.
    pub apart_rad: f64,
    /// How far from a keyframe's pose the camera is looked for, in metres: ahead and back as far, to the sides half as far. 0 for
    /// nowhere but where it was.
    pub reach_m: f64,
    /// The same, for angles in radians, at most 1.5. 0 for the directions alone that it looked in.
    pub reach_rad: f64,
    /// Share of the ferns, 0 to 1, that must be left to compare a view by as it would look from elsewhere: of few, some keyframe
    /// agrees in most by chance.
    pub min_compared_share: f64,
    /// Places are first looked at in an image of the map that is not wider than this many pixels, if the depth pyramid goes down to
    /// that; 16 to 16384.
    pub glance_width: u32,
    /// That image shows this many times as much as the camera to each side, 1 to 4, so that poses far from the keyframe's can be
    /// compared.
    pub widening: f64,
    /// Poses around a keyframe's from which coarse tracking sets out, of all that were compared there.
    pub searched: u32,
    /// Candidates that are compared with each other before the best of their places is followed up, and the next ones only come
    /// where that is not confirmed.
    pub at_once: u32,
    /// Places that coarse tracking goes on from with the map as seen from there, of all that such candidates lead to.
    pub refined: u32,
    /// The best places that coarse tracking leads to of which each is followed up by tracking in full, until one is confirmed.
    pub followed_up: u32,
    /// Once a place is confirmed, others are followed up only where their error after coarse tracking is at most this many times
    /// as large, at least 1.
    pub rivals_within: f64,
    /// Poses within this many metres and `same_within_rad` of each other are one place: what tracking leads to from one of them, it
    /// leads to from the other.
    pub same_within_m: f64,
    /// The same, for the angle between them in radians.
    pub same_within_rad: f64,
    /// Tracking in full is on images not wider than this many pixels, if the depth pyramid goes down to that; 16 to 16384. 640
    /// finds poses more exactly, and takes four times as long.
    pub trial_width: u32,
    /// The largest distance in metres from a point to the map's plane at the coarsest level of both, 0.0001 to 10: more than
    /// `tracker.extended.max_plane_distance_coarse_m`, for the way is longer than from frame to frame.
    pub max_plane_distance_m: f32,
    /// How often a place is tracked against the map as seen from where tracking led before, at most, until it is confirmed.
    pub rounds: u32,
    /// A place is not confirmed where tracking leads further than this many metres from where the map was seen from: then it
    /// is not what the frame shows that was compared.
    pub cast_within_m: f64,
    /// The same, for the angle in radians.
    pub cast_within_rad: f64,
    /// A place is not confirmed where the chance that it is wrong is larger than this, 0 to 1: less than what makes a frame good
    /// that follows another, for here nothing else speaks for it.
    pub max_chance_wrong: f64,
    /// A place is the frame's where tracking there is good, and at least this share of the frame's depth pixels agree with the
    /// map, 0 to 1.
    pub min_inlier_share: f64,
    /// Share of the small image that must show something, 0 to 1: below it a view becomes no keyframe and is likened to none,
    /// because views in which nothing is seen, as with a covered lens, are all alike. Where both images are compared, each of
    /// them must.
    pub min_valid_share: f64,
    /// Most similar keyframes that may count in an averaged pose.
    pub average_of: u32,
    /// Keyframes count in an averaged pose where they are within this many metres of the most similar one.
    pub average_within_m: f64,
    /// The same, for the angle between them in radians, at most 1.5.
    pub average_within_rad: f64,
}

impl Default for RelocaliserSettings {
    fn default() -> Self {
        Self {
            kind: RelocaliserKind::default(),
            image: RelocaliserImage::default(),
            width: 40,
            height: 30,
            smoothing_px: 2.5,
            ferns: 1000,
            tests: 4,
            seed: 1,
            min_dissimilarity: 0.1,
            place_within_m: 1.0,
            place_within_rad: 0.7,
            candidates: 16,
            apart_m: 0.3,
            apart_rad: 0.3,
            reach_m: 0.6,
            reach_rad: 0.42,
            min_compared_share: 0.125,
            glance_width: 160,
            widening: 1.7,
            searched: 3,
            at_once: 4,
            refined: 3,
            followed_up: 3,
            rivals_within: 1.5,
            same_within_m: 0.05,
            same_within_rad: 0.05,
            trial_width: 320,
            max_plane_distance_m: 0.3,
            rounds: 4,
            cast_within_m: 0.1,
            cast_within_rad: 0.1,
            max_chance_wrong: 0.02,
            min_inlier_share: 0.5,
            min_valid_share: 0.2,
            average_of: 5,
            average_within_m: 0.3,
            average_within_rad: 0.35,
        }
    }
}

/// A kind of relocaliser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RelocaliserKind {
    /// No keyframes are kept: after a loss, tracking looks around the last good pose only.
    Off,
    /// Random ferns (Glocker et al. 2015).
    #[default]
    Ferns,
}

/// Which images a relocaliser compares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RelocaliserImage {
    /// Depth, which light does not change.
    #[default]
    Depth,
    /// Colour, which tells flat walls apart.
    Colour,
    /// Both, a quarter of the tests looking at depth and one at each of red, green and blue.
    Both,
}

impl RelocaliserImage {
    /// Every choice.
    pub const ALL: [Self; 3] = [Self::Depth, Self::Colour, Self::Both];

    /// Its name in settings.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::Colour => "colour",
            Self::Both => "both",
        }
    }
}

impl RelocaliserSettings {
    /// Checks every value's range.
    ///
    /// # Errors
    /// The first value out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let side = 1..=512;
        check(side.contains(&self.width), "relocaliser.width", "between 1 and 512", self.width)?;
        check(side.contains(&self.height), "relocaliser.height", "between 1 and 512", self.height)?;
        check(
            in_range(self.smoothing_px, 0.0, 512.0),
            "relocaliser.smoothing_px",
            "between 0 and 512",
            self.smoothing_px,
        )?;
        check((1..=1 << 14).contains(&self.ferns), "relocaliser.ferns", "between 1 and 16384", self.ferns)?;
        check((1..=8).contains(&self.tests), "relocaliser.tests", "between 1 and 8", self.tests)?;
        check((1..=1000).contains(&self.candidates), "relocaliser.candidates", "between 1 and 1000", self.candidates)?;
        for (key, count) in [
            ("relocaliser.searched", self.searched),
            ("relocaliser.at_once", self.at_once),
            ("relocaliser.refined", self.refined),
            ("relocaliser.followed_up", self.followed_up),
            ("relocaliser.rounds", self.rounds),
            ("relocaliser.average_of", self.average_of),
        ] {
            check((1..=100).contains(&count), key, "between 1 and 100", count)?;
        }
        for (key, pixels) in
            [("relocaliser.glance_width", self.glance_width), ("relocaliser.trial_width", self.trial_width)]
        {
            check((16..=1 << 14).contains(&pixels), key, "between 16 and 16384", pixels)?;
        }
        check((1.0..=4.0).contains(&self.widening), "relocaliser.widening", "between 1 and 4", self.widening)?;
        check(
            in_range(self.max_plane_distance_m, 1e-4, 10.0),
            "relocaliser.max_plane_distance_m",
            "between 0.0001 and 10",
            self.max_plane_distance_m,
        )?;
        check(
            (1.0..=1e6).contains(&self.rivals_within),
            "relocaliser.rivals_within",
            "between 1 and 1000000",
            self.rivals_within,
        )?;
        for (key, share) in [
            ("relocaliser.max_chance_wrong", self.max_chance_wrong),
            ("relocaliser.min_compared_share", self.min_compared_share),
            ("relocaliser.min_dissimilarity", self.min_dissimilarity),
            ("relocaliser.min_inlier_share", self.min_inlier_share),
            ("relocaliser.min_valid_share", self.min_valid_share),
        ] {
            check((0.0..=1.0).contains(&share), key, "between 0 and 1", share)?;
        }
        for (key, metres) in [
            ("relocaliser.place_within_m", self.place_within_m),
            ("relocaliser.average_within_m", self.average_within_m),
            ("relocaliser.apart_m", self.apart_m),
            ("relocaliser.reach_m", self.reach_m),
            ("relocaliser.same_within_m", self.same_within_m),
            ("relocaliser.cast_within_m", self.cast_within_m),
        ] {
            check((0.0..=1000.0).contains(&metres), key, "between 0 and 1000", metres)?;
        }
        for (key, radians) in [
            ("relocaliser.place_within_rad", self.place_within_rad),
            ("relocaliser.apart_rad", self.apart_rad),
            ("relocaliser.same_within_rad", self.same_within_rad),
            ("relocaliser.cast_within_rad", self.cast_within_rad),
        ] {
            check((0.0..=4.0).contains(&radians), key, "between 0 and 4", radians)?;
        }
        for (key, radians) in
            [("relocaliser.reach_rad", self.reach_rad), ("relocaliser.average_within_rad", self.average_within_rad)]
        {
            check((0.0..=1.5).contains(&radians), key, "between 0 and 1.5", radians)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    #[test]
    fn values_come_from_overrides_and_out_of_range_ones_are_named() {
        let settings = Settings::resolve(None, &["relocaliser.image=both".into(), "relocaliser.kind=off".into()]);
        let settings = settings.unwrap().relocaliser;
        assert_eq!((settings.kind, settings.image), (RelocaliserKind::Off, RelocaliserImage::Both));
        for bad in [
            "width=0",
            "height=513",
            "smoothing_px=nan",
            "ferns=0",
            "ferns=4000000000",
            "tests=9",
            "candidates=0",
            "min_dissimilarity=1.01",
            "min_dissimilarity=nan",
            "min_valid_share=-0.1",
            "place_within_m=-1.0",
            "place_within_rad=5.0",
            "average_within_m=inf",
            "average_within_rad=3.0",
            "apart_m=-0.1",
            "apart_rad=nan",
            "reach_m=inf",
            "reach_rad=1.6",
            "widening=0.9",
            "searched=0",
            "at_once=0",
            "refined=101",
            "followed_up=0",
            "rivals_within=0.5",
            "rounds=0",
            "average_of=0",
            "glance_width=8",
            "trial_width=0",
            "max_chance_wrong=1.1",
            "min_compared_share=-0.1",
            "same_within_m=-1.0",
            "same_within_rad=nan",
            "max_plane_distance_m=0.0",
            "cast_within_m=inf",
            "cast_within_rad=4.1",
        ] {
            let error = Settings::resolve(None, &[format!("relocaliser.{bad}")]).unwrap_err();
            let (name, _) = bad.split_once('=').unwrap();
            assert!(matches!(&error, SettingsError::Value { key, .. } if key.ends_with(name)), "{bad}: {error}");
        }
        assert!(Settings::resolve(None, &["relocaliser.image=grey".into()]).is_err());
    }

    #[test]
    fn images_are_called_what_settings_call_them() {
        for image in RelocaliserImage::ALL {
            let given = format!("relocaliser.image={}", image.name());
            assert_eq!(Settings::resolve(None, &[given]).unwrap().relocaliser.image, image);
        }
    }
}
