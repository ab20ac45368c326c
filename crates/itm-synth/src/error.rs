//! What can go wrong.

use std::path::PathBuf;

use itm_core::CalibrationError;
use thiserror::Error;

use crate::{Path, SceneName};

/// Why a recording or a surface could not be made.
#[derive(Debug, Error)]
pub enum Error {
    /// No path has this name.
    #[error(
        "there is no path named '{found}'; there are arc, loop, shake, covered, fast, wall, hall, corridor, eight, rooms, \
         kidnapped and carried"
    )]
    UnknownPath {
        /// The name asked for.
        found: String,
    },
    /// No scene has this name.
    #[error("there is no scene named '{found}'; there are room, hall, wall, blank-wall, corridor, two-rooms and rooms")]
    UnknownScene {
        /// The name asked for.
        found: String,
    },
    /// The path leads through another scene.
    #[error("the path '{path}' does not lead through the scene '{found}' but through '{expected}'")]
    Scene {
        /// The path.
        path: Path,
        /// The scene asked for.
        found: SceneName,
        /// The scene that the path is made for.
        expected: SceneName,
    },
    /// A number that cannot be meant.
    #[error("{name} must be {expected}, not {found}")]
    Value {
        /// Which number.
        name: &'static str,
        /// What would do.
        expected: &'static str,
        /// What was found.
        found: f64,
    },
    /// The camera cannot be used.
    #[error(transparent)]
    Camera(#[from] CalibrationError),
    /// A file or folder could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Which one.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// An image could not be written.
    #[error("cannot write {path}: {source}")]
    WriteImage {
        /// Which one.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
}
