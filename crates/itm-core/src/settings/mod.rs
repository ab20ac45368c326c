//! The settings of a run: one tree, documented where it is defined, unknown keys refused.

mod live;
mod relocaliser;
#[cfg(all(test, feature = "schema"))]
mod schema_tests;
mod submaps;
mod surfels;
mod tracker;
mod tracker_string;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::voxel::{BEST_OBSERVATION, DistanceKind};
pub use live::LIVE_SETTINGS;
pub use relocaliser::{RelocaliserImage, RelocaliserKind, RelocaliserSettings};
pub use submaps::SubmapSettings;
pub use surfels::{DynamicsSettings, SurfelSettings};
pub use tracker::{
    CompositePolicy, CompositeSettings, DepthWeight, ExtendedSettings, FileSettings, ForwardProjectionSettings,
    IcpSettings, ImuSettings, OnFailure, RgbSettings, TrackerKind, TrackerSettings, VerdictSettings,
};

/// All settings of a run.
///
/// They come from a TOML file, then `key=value` overrides (`map.voxel_size_m=0.01`), then a program's own flags, later
/// ones winning. Every run writes the resolved tree beside its results.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// What kind of map is made.
    pub mode: Mode,
    /// Which adapter computes.
    pub device: DeviceSettings,
    /// From raw images to what tracking and fusion use.
    pub view: ViewSettings,
    /// The volumetric map.
    pub map: MapSettings,
    /// How the camera is tracked.
    pub tracker: TrackerSettings,
    /// How a place is found again.
    pub relocaliser: RelocaliserSettings,
    /// How a map of submaps is divided and kept consistent.
    pub submaps: SubmapSettings,
    /// How a map of surfels is made.
    pub surfels: SurfelSettings,
}

/// What kind of map is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// One map, in which an error of tracking stays.
    #[default]
    Basic,
    /// Many submaps, whose poses are corrected where the camera comes back to a place; see `submaps`. Poses that come from
    /// elsewhere (`--poses given`, `tracker.kind = "file"`) are those of one map, which stays one.
    LoopClosure,
    /// One map of surfels, discs on surfaces, in place of voxels; see `surfels`.
    Surfels,
    /// Many submaps of surfels.
    SurfelsLoopClosure,
}

impl Mode {
    /// Its name in settings.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Basic => "basic",
            Self::LoopClosure => "loop-closure",
            Self::Surfels => "surfels",
            Self::SurfelsLoopClosure => "surfels-loop-closure",
        }
    }

    /// Whether maps are made of surfels, and not of voxels.
    pub const fn has_surfels(self) -> bool {
        matches!(self, Self::Surfels | Self::SurfelsLoopClosure)
    }

    /// Whether maps are divided into submaps, and loops closed.
    pub const fn has_submaps(self) -> bool {
        matches!(self, Self::LoopClosure | Self::SurfelsLoopClosure)
    }
}

/// Which adapter computes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct DeviceSettings {
    /// `auto` for the best one, a number from `itm devices`, or a part of the adapter's name.
    pub adapter: String,
}

impl Default for DeviceSettings {
    fn default() -> Self {
        Self { adapter: "auto".into() }
    }
}

/// From raw images to what tracking and fusion use.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ViewSettings {
    /// Depth below this many metres is ignored.
    pub min_depth_m: f32,
    /// Depth beyond this many metres is ignored.
    pub max_depth_m: f32,
    /// Smoothing of depth that keeps edges.
    pub bilateral: BilateralSettings,
    /// Whether colour is used where the recording has it.
    pub colour: bool,
    /// Whether a colour image counts as taken when the recording says, rather than together with its depth image.
    pub colour_times: bool,
    /// Seconds by which colour images were taken later than that.
    pub colour_delay_s: f64,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self {
            min_depth_m: 0.2,
            max_depth_m: 4.0,
            bilateral: BilateralSettings::default(),
            colour: true,
            colour_times: true,
            colour_delay_s: 0.0,
        }
    }
}

/// A bilateral filter whose range follows a Kinect's noise: σ(z) = 0.0012 + 0.0019 (z - 0.4)² metres (Nguyen et al.
/// 2012, *Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking*).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct BilateralSettings {
    /// Number of 5x5 passes; 0 switches the filter off.
    pub passes: u32,
}

/// The volumetric map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct MapSettings {
    /// Edge of a voxel in metres.
    pub voxel_size_m: f32,
    /// Truncation band mu: distances are kept up to this many metres from a surface.
    pub truncation_m: f32,
    /// Observations after which a voxel's weight stops growing, at most 65535, or 4095 where `observation_weight` is
    /// `noise`. A low one follows changes sooner.
    pub max_weight: u16,
    /// How much an observation counts in a voxel's mean.
    pub observation_weight: ObservationWeight,
    /// Whether voxels at the largest weight are left as they are.
    pub stop_at_max_weight: bool,
    /// How voxels keep distances: `i16` in 16 bits, or `f32` in single precision with twice the memory.
    pub distance: DistanceKind,
    /// Whether voxels hold colour, where the recording has it.
    pub colour: bool,
    /// Whether voxels hold a confidence: how many of the best observations would tell as much as those made, by the noise of
    /// a Kinect's depth (Nguyen et al. 2012) and the viewing angle. Tracking weighs points by it, in place of the number of
    /// observations.
    pub confidence: bool,
    /// What a voxel that claims to be near a surface loses of its weight each time it is seen to be empty, so that what was
    /// carried away disappears: observations, 0 for none, as many as `max_weight` to forget at once.
    pub empty_loss: u16,
    /// Colour is fused where the distance to the surface is at most this share of the truncation band.
    pub colour_band: f32,
    /// Whether frames are fused into the map; off to find the camera in a map without changing it.
    pub fuse: bool,
    /// How blocks are found: `hash`, wherever the camera goes, or `dense`, a box of `dense.size` that is there as a whole from
    /// the start and beyond which nothing is kept.
    pub index: MapIndex,
    /// Blocks (512 voxels each) that the pools hold at the start; they grow as needed.
    pub initial_blocks: u32,
    /// Device memory that voxels may take, in MiB: the pools grow up to it. 0 is as much as the adapter can bind. What finds
    /// blocks takes about 60 bytes a block more.
    pub device_budget_mib: f64,
    /// What happens once `device_budget_mib` is reached.
    pub swapping: Swapping,
    /// Host memory that blocks which left the device may take, in MiB; more of them lie in a file.
    pub host_budget_mib: f64,
    /// Folder of that file, which has no name and is gone with the run; empty for the system's folder for temporary files.
    /// Some systems keep that one in memory: name one on a disk there.
    pub host_folder: String,
    /// Path of a file to take instead, which stays when the run ends and is overwritten by the next. Empty for none.
    pub host_file: String,
    /// Blocks that are transferred in a frame at most, each way.
    pub transfer_blocks: u32,
    /// Blocks come back to the device once they are within this many metres of the view, and do not leave before they are
    /// further away.
    pub swap_margin_m: f32,
    /// Whether each block remembers the last frame that changed it, so that a program can ask for those that changed since.
    pub track_changes: bool,
    /// The box of a dense map.
    pub dense: DenseSettings,
}

/// How blocks are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum MapIndex {
    /// By a hash: blocks are where surfaces are, wherever the camera goes.
    #[default]
    Hash,
    /// A box of voxels, all of which are there from the start: needs memory for its empty space too, but no allocation.
    Dense,
}

/// The box of a dense map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct DenseSettings {
    /// Voxels along the world's x, y and z, each a multiple of 8.
    pub size: [u32; 3],
    /// The first voxel along each axis, from the world's origin, each a multiple of 8.
    pub offset: [i32; 3],
}

impl Default for DenseSettings {
    fn default() -> Self {
        Self { size: [512; 3], offset: [-256, -256, 0] }
    }
}

impl DenseSettings {
    /// Blocks along each axis, and the first one.
    pub fn blocks(&self) -> ([u32; 3], [i32; 3]) {
        (self.size.map(|voxels| voxels / 8), self.offset.map(|voxels| voxels / 8))
    }

    fn validate(&self) -> Result<(), SettingsError> {
        let size = self.size.iter().all(|v| (8..=1 << 15).contains(v) && v % 8 == 0);
        check(size, "map.dense.size", "three multiples of 8 from 8 to 32768", format!("{:?}", self.size))?;
        let offset = self.offset.iter().all(|v| (-(1 << 18)..=(1 << 17)).contains(v) && v % 8 == 0);
        check(offset, "map.dense.offset", "three multiples of 8 from -262144 to 131072", format!("{:?}", self.offset))
    }
}

/// What happens once the device's budget is reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Swapping {
    /// New blocks find no room: what they would show is not mapped, and each frame says so.
    Off,
    /// Blocks that were not seen for the longest time move to the host, and come back when the view comes near them.
    #[default]
    Host,
    /// Blocks that were not seen for the longest time are deleted.
    Delete,
}

impl Default for MapSettings {
    fn default() -> Self {
        Self {
            voxel_size_m: 0.005,
            truncation_m: 0.02,
            max_weight: 100,
            observation_weight: ObservationWeight::Constant,
            stop_at_max_weight: false,
            distance: DistanceKind::I16,
            colour: true,
            confidence: false,
            empty_loss: 0,
            colour_band: 0.25,
            fuse: true,
            index: MapIndex::Hash,
            initial_blocks: 16_384,
            device_budget_mib: 0.0,
            swapping: Swapping::Host,
            host_budget_mib: 2048.0,
            host_folder: String::new(),
            host_file: String::new(),
            transfer_blocks: 4096,
            swap_margin_m: 0.1,
            track_changes: false,
            dense: DenseSettings::default(),
        }
    }
}

/// How much an observation counts in a voxel's mean.
///
/// Voxels add the weights up in the 16 bits that otherwise count observations. A unit is the least observation, so that
/// whatever was seen has a weight, and everything that asks for at least so many observations (tracking, meshing) is never
/// harder to please than with constant weights; where the unit was the best observation, far surfaces were too little
/// trusted to be tracked by. The price: such a threshold may be met by fewer observations, and meshes' weights count
/// least observations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ObservationWeight {
    /// One, whatever it is.
    #[default]
    Constant,
    /// `16 (σ(0.4) / σ(z))² cos θ`, rounded, at least 1: by the variance of a Kinect's depth, σ(z) = 0.0012 + 0.0019 (z -
    /// 0.4)² metres (Nguyen et al. 2012), and the angle θ between ray and surface normal (Newcombe et al. 2011,
    /// section 3.3). The largest weight, `map.max_weight`, counts the best observations then.
    Noise,
}

/// Why settings cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SettingsError {
    /// The file, or an override, is no valid TOML or has an unknown key or a value of the wrong kind. The message
    /// lists the keys that would do.
    #[error("{source_name}: {message}")]
    Parse {
        /// File name, or the override as given.
        source_name: String,
        /// What is wrong and where.
        message: String,
    },
    /// An override that is not `key=value`.
    #[error("'{given}' is not of the form key=value, as in map.voxel_size_m=0.01")]
    NotAnOverride {
        /// As given.
        given: String,
    },
    /// A tracker's string that cannot be used.
    #[error("the tracker '{given}': {message}")]
    TrackerString {
        /// As given.
        given: String,
        /// What is wrong, and what would do.
        message: String,
    },
    /// A value out of its range.
    #[error("{key} must be {expected}, not {found}")]
    Value {
        /// Full key.
        key: &'static str,
        /// What would do.
        expected: &'static str,
        /// What was found.
        found: String,
    },
}

impl Settings {
    /// Resolves a settings file's text (with the name to show in errors) and overrides, later ones winning.
    ///
    /// An override's value is TOML where it parses as such, and a string otherwise: `tracker.icp.levels=rrb` needs no
    /// quotes.
    ///
    /// # Errors
    /// Unknown keys, wrong kinds and values out of range.
    pub fn resolve(file: Option<(&str, &str)>, overrides: &[String]) -> Result<Self, SettingsError> {
        let parse_error = |source_name: &str, message: &dyn std::fmt::Display| SettingsError::Parse {
            source_name: source_name.into(),
            message: message.to_string().trim_end().to_string(),
        };
        let mut tree = toml::Table::new();
        if let Some((name, text)) = file {
            tree = text.parse().map_err(|e| parse_error(name, &e))?;
            if tree.get("tracker").is_some_and(toml::Value::is_str) {
                unfold_tracker(&mut tree).map_err(|e| parse_error(name, &e))?;
                Self::deserialize(tree.clone()).map_err(|e| parse_error(name, &e))?;
            } else {
                // Deserialised once on its own, so that an error names the file's line.
                toml::from_str::<Self>(text).map_err(|e| parse_error(name, &e))?;
            }
        }
        for given in overrides {
            let not_an_override = || SettingsError::NotAnOverride { given: given.clone() };
            let (key, value) = given.split_once('=').ok_or_else(not_an_override)?;
            let (key, value) = (key.trim(), value.trim());
            let value = format!("v = {value}")
                .parse::<toml::Table>()
                .ok()
                .and_then(|mut t| t.remove("v"))
                .unwrap_or_else(|| toml::Value::String(value.into()));
            let mut parts: Vec<&str> = key.split('.').collect();
            let last = parts.pop().filter(|p| !p.is_empty()).ok_or_else(not_an_override)?;
            let mut table = &mut tree;
            for part in parts {
                table = table
                    .entry(part)
                    .or_insert_with(|| toml::Value::Table(toml::Table::new()))
                    .as_table_mut()
                    .ok_or_else(|| parse_error(given, &format!("'{part}' is a value, not a group of settings")))?;
            }
            if key == "tracker" && value.is_str() {
                // What earlier overrides said stays, where the string does not say otherwise.
                let before = tree.remove("tracker");
                tree.insert("tracker".into(), value);
                unfold_tracker_over(&mut tree, before).map_err(|e| parse_error(given, &e))?;
            } else {
                table.insert(last.into(), value);
            }
            Self::deserialize(tree.clone()).map_err(|e| parse_error(given, &e))?;
        }
        let settings = Self::deserialize(tree).map_err(|e| parse_error("settings", &e))?;
        settings.validate()?;
        Ok(settings)
    }

    /// The whole tree as TOML.
    ///
    /// # Panics
    /// Never: every field has a TOML form.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("settings are tables of numbers, strings and switches")
    }

    /// Checks every value's range.
    ///
    /// # Errors
    /// The first value out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let Self { mode: _, device: _, view, map, tracker, relocaliser, submaps, surfels } = self;
        check(in_range(view.min_depth_m, 0.0, 1000.0), "view.min_depth_m", "between 0 and 1000", view.min_depth_m)?;
        check(
            in_range(view.max_depth_m, 0.0, 1000.0) && view.max_depth_m > view.min_depth_m,
            "view.max_depth_m",
            "larger than view.min_depth_m and at most 1000",
            view.max_depth_m,
        )?;
        check(
            view.colour_delay_s.is_finite() && view.colour_delay_s.abs() <= 1.0,
            "view.colour_delay_s",
            "between -1 and 1",
            view.colour_delay_s,
        )?;
        check(view.bilateral.passes <= 32, "view.bilateral.passes", "at most 32", view.bilateral.passes)?;
        check(in_range(map.voxel_size_m, 1e-4, 10.0), "map.voxel_size_m", "between 0.0001 and 10", map.voxel_size_m)?;
        check(
            in_range(map.truncation_m, map.voxel_size_m, 100.0),
            "map.truncation_m",
            "between map.voxel_size_m and 100",
            map.truncation_m,
        )?;
        check(map.max_weight >= 1, "map.max_weight", "at least 1", map.max_weight)?;
        check(
            map.observation_weight == ObservationWeight::Constant || map.max_weight <= u16::MAX / BEST_OBSERVATION,
            "map.max_weight",
            "at most 4095 where map.observation_weight is noise",
            map.max_weight,
        )?;
        check(in_range(map.colour_band, 0.0, 1.0), "map.colour_band", "between 0 and 1", map.colour_band)?;
        check(
            (1..=1 << 24).contains(&map.initial_blocks),
            "map.initial_blocks",
            "between 1 and 16777216",
            map.initial_blocks,
        )?;
        let budget = |mib: f64| mib >= 0.0 && mib.is_finite();
        check(budget(map.device_budget_mib), "map.device_budget_mib", "zero or positive", map.device_budget_mib)?;
        check(budget(map.host_budget_mib), "map.host_budget_mib", "zero or positive", map.host_budget_mib)?;
        check(
            (1..=1 << 20).contains(&map.transfer_blocks),
            "map.transfer_blocks",
            "1 to 1048576",
            map.transfer_blocks,
        )?;
        check(in_range(map.swap_margin_m, 0.0, 10.0), "map.swap_margin_m", "between 0 and 10", map.swap_margin_m)?;
        map.dense.validate()?;
        tracker.validate()?;
        relocaliser.validate()?;
        submaps.validate()?;
        surfels.validate()?;
        check(
            !self.mode.has_surfels() || !map.track_changes,
            "map.track_changes",
            "false where maps are made of surfels: they have no blocks",
            map.track_changes,
        )?;
        check(
            !self.mode.has_surfels() || !tracker.forward_projection.enabled,
            "tracker.forward_projection.enabled",
            "false where maps are made of surfels: there are no rays to save",
            tracker.forward_projection.enabled,
        )
    }
}

fn check(ok: bool, key: &'static str, expected: &'static str, found: impl ToString) -> Result<(), SettingsError> {
    if ok { Ok(()) } else { Err(SettingsError::Value { key, expected, found: found.to_string() }) }
}

fn in_range(v: f32, lo: f32, hi: f32) -> bool {
    v.is_finite() && v >= lo && v <= hi
}

/// Replaces a tracker's string by the tree that it stands for.
fn unfold_tracker(tree: &mut toml::Table) -> Result<(), SettingsError> {
    unfold_tracker_over(tree, None)
}

/// The same, over a tree from before.
fn unfold_tracker_over(tree: &mut toml::Table, before: Option<toml::Value>) -> Result<(), SettingsError> {
    let Some(toml::Value::String(given)) = tree.remove("tracker") else { return Ok(()) };
    let mut settings = match before {
        // It has been read before, so it can be read.
        Some(before) => TrackerSettings::deserialize(before).unwrap_or_default(),
        None => TrackerSettings::default(),
    };
    settings.set_string(&given)?;
    let value = toml::Value::try_from(&settings).expect("settings are tables of numbers, strings and switches");
    tree.insert("tracker".into(), value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_reads_back() {
        let settings = Settings::default();
        assert_eq!(Settings::resolve(Some(("s.toml", &settings.to_toml())), &[]), Ok(settings));
    }

    #[test]
    fn overrides_win_over_the_file_and_need_no_quotes() {
        let file = "[map]\nvoxel_size_m = 0.02\ntruncation_m = 0.08\n";
        let overrides = ["map.voxel_size_m=0.01".to_string(), "tracker.icp.levels=rb".to_string()];
        let settings = Settings::resolve(Some(("s.toml", file)), &overrides).unwrap();
        assert_eq!(settings.map.voxel_size_m, 0.01);
        assert_eq!(settings.map.truncation_m, 0.08);
        assert_eq!(settings.tracker.icp.levels, "rb");
    }

    #[test]
    fn unknown_keys_are_refused_with_the_line_and_the_valid_ones() {
        let error = Settings::resolve(Some(("my.toml", "[map]\nvoxel = 1\n")), &[]).unwrap_err().to_string();
        assert!(error.contains("my.toml") && error.contains("line 2"), "{error}");
        assert!(error.contains("voxel_size_m"), "{error}");
        let error = Settings::resolve(None, &["map.voxels=1".into()]).unwrap_err().to_string();
        assert!(error.contains("map.voxels=1") && error.contains("voxel_size_m"), "{error}");
        assert!(matches!(Settings::resolve(None, &["map".into()]), Err(SettingsError::NotAnOverride { .. })));
        assert!(Settings::resolve(None, &["map.max_weight.x=1".into(), "map.max_weight=5".into()]).is_err());
    }

    #[test]
    fn values_out_of_range_are_refused() {
        for bad in [
            "map.voxel_size_m=0.0",
            "map.voxel_size_m=nan",
            "map.truncation_m=0.001",
            "map.truncation_m=1e8",
            "view.max_depth_m=0.1",
            "view.min_depth_m=-1.0",
            "tracker.icp.levels=rx",
            "map.initial_blocks=0",
            "map={max_weight=4096, observation_weight='noise'}",
        ] {
            let error = Settings::resolve(None, &[bad.into()]).unwrap_err();
            assert!(matches!(error, SettingsError::Value { .. }), "{bad}: {error}");
        }
    }
}
