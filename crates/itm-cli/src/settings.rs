//! What command lines say of settings, by all commands that reconstruct.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use itm_core::{Mode, Settings};
use itm_io::map_file::MapReader;
use itm_io::recording::RecordingInfo;
use itm_slam::Poses;

/// What a command line says of settings.
#[derive(Args)]
pub(crate) struct SettingsArguments {
    /// Settings as TOML; every run writes its own to OUT/settings.toml
    #[arg(long = "settings", id = "settings", value_name = "FILE")]
    file: Option<PathBuf>,
    /// A single setting, which wins over the file: --set map.voxel_size_m=0.01 (may be repeated)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// The tracker as one string, type=KIND,key=value,... (see below); wins over the settings and --set
    #[arg(long, value_name = "STRING")]
    tracker: Option<String>,
    /// What kind of map is made; wins over the settings and --set
    #[arg(long, value_enum)]
    mode: Option<ModeArgument>,
    /// Where camera poses come from
    #[arg(long, value_enum, default_value_t = PosesArgument::Tracked)]
    poses: PosesArgument,
    /// Adapter: auto, a number from 'itm devices' or a part of its name; wins over the settings
    #[arg(long)]
    device: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PosesArgument {
    /// From tracking
    Tracked,
    /// The recording's own
    Given,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModeArgument {
    /// One map, in which an error of tracking stays
    Basic,
    /// Submaps that are corrected where the camera comes back to a place
    LoopClosure,
    /// One map of discs on surfaces
    Surfels,
    /// Submaps of discs on surfaces
    SurfelsLoopClosure,
}

impl SettingsArguments {
    /// Where poses come from.
    pub(crate) fn poses(&self) -> Poses {
        match self.poses {
            PosesArgument::Tracked => Poses::Tracked,
            PosesArgument::Given => Poses::Given,
        }
    }

    /// The settings that are meant: the file's, or those of a saved map where there is none, with what the command line says
    /// besides.
    pub(crate) fn resolve(&self, map: Option<&Path>) -> Result<Settings> {
        let file = match &self.file {
            None => None,
            Some(path) => {
                let name = path.display().to_string();
                let text = fs::read_to_string(path).with_context(|| format!("cannot read the settings '{name}'"))?;
                Some((name, text))
            }
        };
        let file = match (file, map) {
            (None, Some(path)) => {
                let reader = MapReader::open(path)?;
                Some((format!("the settings in '{}'", path.display()), reader.header().settings.clone()))
            }
            (file, _) => file,
        };
        let file = file.as_ref().map(|(name, text)| (name.as_str(), text.as_str()));
        let mut settings = Settings::resolve(file, &self.overrides)?;
        if let Some(tracker) = &self.tracker {
            settings.tracker.set_string(tracker)?;
        }
        if let Some(device) = &self.device {
            settings.device.adapter.clone_from(device);
        }
        match self.mode {
            Some(ModeArgument::Basic) => settings.mode = Mode::Basic,
            Some(ModeArgument::LoopClosure) => settings.mode = Mode::LoopClosure,
            Some(ModeArgument::Surfels) => settings.mode = Mode::Surfels,
            Some(ModeArgument::SurfelsLoopClosure) => settings.mode = Mode::SurfelsLoopClosure,
            None => {}
        }
        Ok(settings)
    }
}

/// Frames as asked for: `A..B`, `A..` or `..B`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameRange {
    start: usize,
    end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected A..B, A.. or ..B with frame numbers from 0, not '{text}'");
        let (start, end) = text.split_once("..").ok_or_else(expected)?;
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| expected());
        let start = if start.trim().is_empty() { 0 } else { number(start)? };
        let end = if end.trim().is_empty() { None } else { Some(number(end)?) };
        match end {
            Some(end) if end <= start => Err(format!("'{text}' holds no frame: the last number is not included")),
            _ => Ok(Self { start, end }),
        }
    }
}

impl FrameRange {
    /// The first, and the one after the last, where one is named.
    pub(crate) fn ends(self) -> (usize, Option<usize>) {
        (self.start, self.end)
    }

    pub(crate) fn within(self, info: &RecordingInfo) -> Result<Range<usize>> {
        let range = self.start..self.end.unwrap_or(info.frames);
        if range.is_empty() || range.end > info.frames {
            let shown = self.end.map_or_else(String::new, |end| end.to_string());
            let (start, last) = (self.start, info.frames.saturating_sub(1));
            bail!("--frames {start}..{shown}: the recording '{}' has frames 0 to {last}", info.name);
        }
        Ok(range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_frames() {
        let range = |start, end| Ok(FrameRange { start, end });
        assert_eq!("2..5".parse(), range(2, Some(5)));
        assert_eq!("2..".parse(), range(2, None));
        assert_eq!("..5".parse(), range(0, Some(5)));
        assert_eq!("..".parse(), range(0, None));
        for bad in ["", "5", "5..5", "6..5", "-1..5", "a..b", "1..2..3", "1..=2", "0..0"] {
            assert!(bad.parse::<FrameRange>().is_err(), "{bad}");
        }
    }
}
