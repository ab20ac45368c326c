//! What can be opened, and how it is told apart.

use std::path::{Path, PathBuf};

use itm_io::map_file::is_map_file;
use itm_io::recording::{self, OpenOptions};
use itm_slam::{Poses, Settings};

/// What a run writes into its folder, one of which is always there.
const RESULTS: [&str; 2] = ["trajectory.txt", "mesh.ply"];

/// What the reconstruction of a recording starts from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) enum OpenAs {
    /// An empty map.
    #[default]
    Afresh,
    /// A saved map, which the camera is looked for in.
    InMap(PathBuf),
    /// A saved map, after the frame that was its last.
    GoingOn(PathBuf),
}

/// Something to open.
#[derive(Clone, Debug)]
pub(crate) struct Open {
    pub(crate) path: PathBuf,
    /// For recordings: how they are read.
    pub(crate) options: OpenOptions,
    /// For recordings: how they are reconstructed.
    pub(crate) settings: Settings,
    pub(crate) poses: Poses,
    /// For recordings: the first frame, by its place, and the one after the last, if that is not the recording's end.
    pub(crate) frames: (usize, Option<usize>),
    /// For recordings: what they start from.
    pub(crate) start: OpenAs,
    /// Whether frames are processed at once.
    pub(crate) run: bool,
}

impl Open {
    /// Opens what lies at a path as it says itself.
    pub(crate) fn new(path: impl Into<PathBuf>, settings: &Settings) -> Self {
        Self {
            path: path.into(),
            options: OpenOptions::default(),
            settings: settings.clone(),
            poses: Poses::Tracked,
            frames: (0, None),
            start: OpenAs::Afresh,
            run: true,
        }
    }
}

/// What lies at a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WhatItIs {
    Recording,
    Map,
    Results,
}

/// Finds out what lies at a path.
///
/// # Errors
/// Where there is nothing, or nothing that can be opened, in words.
pub(crate) fn recognise(path: &Path) -> Result<WhatItIs, String> {
    let shown = path.display();
    if path.is_dir() {
        // A recording in TUM's format has a trajectory too, but not by this name beside a run's settings.
        let of_run = path.join("settings.toml").is_file() && RESULTS.iter().any(|name| path.join(name).is_file());
        return Ok(if of_run { WhatItIs::Results } else { WhatItIs::Recording });
    }
    if !path.exists() {
        return Err(format!("'{shown}' does not exist"));
    }
    if is_map_file(path) {
        Ok(WhatItIs::Map)
    } else if recording::is_file_of_recording(path) {
        Ok(WhatItIs::Recording)
    } else if path.file_name().is_some_and(|name| name == "report.html") {
        Ok(WhatItIs::Results)
    } else {
        Err(format!("'{shown}' is neither a map (.itm) nor a recording (.mcap, or a folder) nor the results of a run"))
    }
}
