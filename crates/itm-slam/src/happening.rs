//! What happens to the map beside a frame's fusion.

/// Something that happened with a frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Happening {
    /// The frame's view is remembered, to find the place again.
    Keyframe {
        /// Its number.
        id: u32,
        /// The submap that its pose is relative to.
        submap: u16,
    },
    /// The camera was found again after a loss.
    Relocalised {
        /// The keyframe whose view was alike.
        keyframe: u32,
        /// Its submap.
        submap: u16,
        /// How little alike: 0 to 1.
        dissimilarity: f64,
    },
}

impl std::fmt::Display for Happening {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Keyframe { id, submap } => write!(f, "keyframe {id} in submap {submap}"),
            Self::Relocalised { keyframe, submap, dissimilarity } => {
                write!(f, "found again near keyframe {keyframe} of submap {submap} (dissimilarity {dissimilarity:.2})")
            }
        }
    }
}
