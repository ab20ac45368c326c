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
    /// Most similar keyframes whose poses are tried after a loss.
    pub candidates: u32,
    /// A candidate's place is the frame's where tracking there is good, and at least this share of the frame's depth pixels agree
    /// with the map, 0 to 1.
    pub min_inlier_share: f64,
    /// Share of the small image that must show something, 0 to 1: below it a view becomes no keyframe and is likened to none,
    /// because views in which nothing is seen, as with a covered lens, are all alike. Where both images are compared, each of
    /// them must.
    pub min_valid_share: f64,
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
            candidates: 5,
            min_inlier_share: 0.5,
            min_valid_share: 0.2,
            average_within_m: 0.3,
            average_within_rad: 0.35,
        }
    }
}

/// A kind of relocaliser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
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
        for (key, share) in [
            ("relocaliser.min_dissimilarity", self.min_dissimilarity),
            ("relocaliser.min_inlier_share", self.min_inlier_share),
            ("relocaliser.min_valid_share", self.min_valid_share),
        ] {
            check((0.0..=1.0).contains(&share), key, "between 0 and 1", share)?;
        }
        for (key, metres) in [
            ("relocaliser.place_within_m", self.place_within_m),
            ("relocaliser.average_within_m", self.average_within_m),
        ] {
            check((0.0..=1000.0).contains(&metres), key, "between 0 and 1000", metres)?;
        }
        check(
            (0.0..=4.0).contains(&self.place_within_rad),
            "relocaliser.place_within_rad",
            "between 0 and 4",
            self.place_within_rad,
        )?;
        check(
            (0.0..=1.5).contains(&self.average_within_rad),
            "relocaliser.average_within_rad",
            "between 0 and 1.5",
            self.average_within_rad,
        )
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
