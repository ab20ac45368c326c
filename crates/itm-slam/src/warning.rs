//! What a session goes on without.

use std::path::PathBuf;

/// Something that was no use and was left out, so that a session could go on without it. A line of the log says the same.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Warning {
    /// A part of a map file.
    LeftOut {
        /// The file.
        path: PathBuf,
        /// The part's section in it.
        section: String,
        /// Which part.
        what: String,
        /// Why, and what comes of it.
        reason: String,
    },
    /// A submap whose blocks are all gone: the camera is not looked for there any more. What was measured between it and others
    /// stays.
    SubmapWithoutBlocks {
        /// Its number.
        submap: u16,
        /// How many keyframes went with it.
        keyframes: usize,
    },
    /// No submap begins any more, as its box would find no room in a dense map.
    NoFurtherSubmap {
        /// How much room there is.
        reason: String,
    },
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::LeftOut { path, section, what, reason } => {
                write!(f, "'{}', section {section}: {what} left out: {reason}", path.display())
            }
            Self::SubmapWithoutBlocks { submap, keyframes } => {
                write!(f, "submap {submap} has no blocks and is left out, with its {keyframes} keyframes")
            }
            Self::NoFurtherSubmap { reason } => write!(f, "no further submap begins: {reason}"),
        }
    }
}
