//! What a relocaliser keeps and answers.

use itm_core::{Se3, Timestamp};

/// A place that the camera was at, whose view is remembered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Its number, given in the order of harvesting and never given again.
    pub id: u32,
    /// The submap that its pose is relative to.
    pub submap: u16,
    /// Where the camera was in that submap; moving the submap as a whole leaves it as it is.
    pub submap_from_camera: Se3,
    /// When the view was taken.
    pub timestamp: Timestamp,
}

/// A keyframe that resembles a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The keyframe.
    pub keyframe: Keyframe,
    /// How little the view resembles it: 0 where nothing tells them apart, and less than 1.
    pub dissimilarity: f64,
}

/// What came of offering a view as a keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Harvest {
    /// It is a keyframe now.
    Added {
        /// The new keyframe's number.
        id: u32,
        /// The most similar one of those of its place before, if any has anything in common with the view.
        nearest: Option<Candidate>,
    },
    /// It resembles one of its place that there is already.
    Known {
        /// That keyframe, the most similar one.
        nearest: Candidate,
    },
    /// Too little is seen to know the place again.
    Blind {
        /// Share of the small image that shows something, below `relocaliser.min_valid_share`.
        valid_share: f64,
    },
}
