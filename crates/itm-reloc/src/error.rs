//! What can go wrong.

use itm_core::{PoseError, SettingsError};
use thiserror::Error;

/// Why a relocaliser cannot do what is asked.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting out of its range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A small image is not of the size that it must have.
    #[error("the small {what} image must be {}x{} pixels, not {}x{}", .expected.0, .expected.1, .found.0, .found.1)]
    ViewSize {
        /// Which image: `depth` or `colour`.
        what: &'static str,
        /// Width and height that it must have.
        expected: (u32, u32),
        /// Those that it has.
        found: (u32, u32),
    },
    /// A view as it would look from elsewhere ([`crate::SmallView::seen_from`]) was to become a keyframe.
    #[error("a view as it would look from elsewhere tells of a part of its pixels only, and cannot become a keyframe")]
    PartOfAView,
    /// A keyframe's pose is no rigid motion.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// There is no keyframe of this number.
    #[error("there is no keyframe {id}")]
    NoKeyframe {
        /// The number asked for.
        id: u32,
    },
    /// All numbers that a keyframe can have were given away.
    #[error("there can be no more keyframes: all {} numbers were used", u32::MAX)]
    TooManyKeyframes,
    /// Saved bytes are no keyframes, or not whole.
    #[error("saved keyframes cannot be read: {message}")]
    Damaged {
        /// What is wrong, and at which byte where that can be said.
        message: String,
    },
    /// Saved bytes were written in a form that is not known here.
    #[error("saved keyframes have the version {found}, and only {expected} can be read")]
    Version {
        /// The version that can be read.
        expected: u32,
        /// The one that the bytes have.
        found: u32,
    },
    /// Saved keyframes were made with other settings, so that no view could be compared with them.
    #[error("saved keyframes were made with {}", shown(.differences))]
    SettingsDiffer {
        /// All of those that codes depend on and that differ.
        differences: Vec<Difference>,
    },
}

/// A setting that is not what it was when keyframes were saved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// Full key.
    pub setting: &'static str,
    /// Its value here.
    pub expected: String,
    /// Its value when the keyframes were saved.
    pub found: String,
}

impl std::fmt::Display for Difference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { setting, expected, found } = self;
        write!(f, "{setting} = {found} (here {expected})")
    }
}

fn shown(differences: &[Difference]) -> String {
    differences.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
