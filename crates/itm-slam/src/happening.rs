//! What happens to the map beside a frame's fusion.

use serde::{Deserialize, Serialize};

/// Something that happened with a frame.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
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
    /// A submap begins, and is the primary from this frame on.
    Submap {
        /// Its number.
        submap: u16,
        /// The one before.
        from: u16,
    },
    /// Another active submap becomes the primary.
    Primary {
        /// Its number.
        submap: u16,
        /// The one before.
        from: u16,
    },
    /// The camera is no longer tracked in a submap.
    Passive {
        /// Its number.
        submap: u16,
    },
    /// The pose between two active submaps is measured.
    Linked {
        /// The one.
        from: u16,
        /// The other.
        to: u16,
    },
    /// The camera may be back in a passive submap, and is tracked there on trial.
    ClosureTried {
        /// Its number.
        submap: u16,
        /// The keyframe whose view was alike; `None` where it was tried because the camera should be there.
        keyframe: Option<u32>,
    },
    /// The camera is back in a submap, which is active again.
    ClosureAccepted {
        /// The primary.
        from: u16,
        /// The submap that the camera is back in.
        to: u16,
        /// How far away from where it was thought to be, in metres.
        moved_m: f64,
    },
    /// The camera is not where a view looked like, or that is not sure.
    ClosureRefused {
        /// The submap.
        submap: u16,
        /// Why.
        reason: String,
    },
    /// The submaps' poses were optimised, as of some frames ago, and are in force from this frame on.
    Optimised(Optimised),
}

/// What an optimisation of the submaps' poses did.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Optimised {
    /// Submaps.
    pub submaps: usize,
    /// Links between them.
    pub links: usize,
    /// How far a submap moved at most, in metres.
    pub moved_m: f64,
    /// The graph's cost before and after.
    pub cost: [f64; 2],
    /// Links that hardly count, because the others contradict them.
    pub doubted: usize,
}

impl std::fmt::Display for Happening {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Keyframe { id, submap } => write!(f, "keyframe {id} in submap {submap}"),
            Self::Relocalised { keyframe, submap, dissimilarity } => {
                write!(f, "found again near keyframe {keyframe} of submap {submap} (dissimilarity {dissimilarity:.2})")
            }
            Self::Submap { submap, from } => write!(f, "submap {submap} begins in submap {from}"),
            Self::Primary { submap, from } => write!(f, "submap {submap} is the primary again, after submap {from}"),
            Self::Passive { submap } => write!(f, "submap {submap} is passive"),
            Self::Linked { from, to } => write!(f, "submap {to} was measured in submap {from}"),
            Self::ClosureTried { submap, keyframe: Some(keyframe) } => {
                write!(f, "looks like keyframe {keyframe} of submap {submap}")
            }
            Self::ClosureTried { submap, keyframe: None } => write!(f, "should be back in submap {submap}"),
            Self::ClosureAccepted { from, to, moved_m } => {
                write!(f, "back in submap {to}, which lies {moved_m:.3} m from where submap {from} had it")
            }
            Self::ClosureRefused { submap, reason } => write!(f, "not taken for back in submap {submap}: {reason}"),
            Self::Optimised(Optimised { submaps, links, moved_m, cost: [before, after], doubted }) => {
                write!(f, "{submaps} submaps with {links} links optimised, cost {before:.3e} to {after:.3e}")?;
                write!(f, ", moved by at most {moved_m:.3} m")?;
                if *doubted > 0 { write!(f, "; {doubted} links are contradicted") } else { Ok(()) }
            }
        }
    }
}
