//! Maps of surfels.

use serde::{Deserialize, Serialize};

use super::{SettingsError, check};

/// How a map of surfels is made (Keller et al. 2013, *Real-time 3D Reconstruction in Dynamic Scenes using Point-based Fusion*;
/// the report, section on surfel-based reconstruction). In force with `mode = "surfels"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SurfelSettings {
    /// Surfels that the map has room for at first; it grows.
    pub initial: u32,
    /// Device memory that surfels may take, in MiB; 0 for as much as there is. When it is reached no new surfels are made, and frames
    /// say so.
    pub device_budget_mib: f64,
    /// A surfel's radius by that of the circle around the pixel that sees it.
    pub radius_factor: f32,
    /// Standard deviation of the Gaussian by which measurements count less far from the image's centre, in half its diagonal.
    pub confidence_sigma: f32,
    /// Confidence from which on a surfel is stable.
    pub stable: f32,
    /// Largest confidence: a smaller one follows changes sooner.
    pub max_confidence: f32,
    /// Frames after which an unstable surfel is removed that is looked at again, and not observed.
    pub patience: u32,
    /// Frames after which an unstable surfel that was not observed again is removed wherever it is, so that what was seen in passing does
    /// not fill the memory of a long way.
    pub forget_after: u32,
    /// Confidence from which on surfels are tracked against, once their submap is `all_for` frames old. What is below it is removed
    /// where frames are fused into another submap.
    pub track_from: f32,
    /// So many first frames of a submap are tracked against all surfels.
    pub all_for: u32,
    /// A surfel is a measurement's, and may be drawn though another one is nearer, if their depths differ by at most this many metres …
    pub window_m: f32,
    /// … and so many standard deviations of depth (a Kinect's, Nguyen et al. 2012) more …
    pub window_deviations: f32,
    /// … and their normals by at most this angle in radians.
    pub max_angle_rad: f32,
    /// Pixels to either side between which a measurement's normal is taken.
    pub normal_reach_px: u32,
    /// Measurements at larger angles between ray and normal, in radians, make no surfels.
    pub max_slant_rad: f32,
    /// A surfel's position follows only measurements whose disc is at most so many times as large.
    pub coarser: f32,
    /// A disc covers measurements, which need no surfel then, unless it is more than so many times as large as theirs would be.
    pub finer: f32,
    /// Discs cover, and are tracked against with, so many of their radii.
    pub reach: f32,
    /// For people and meshes discs are drawn with so many of their radii, so that no holes are left between them.
    pub overlap: f32,
    /// Stable surfels of one measurement within this many metres …
    pub merge_m: f32,
    /// … and this angle in radians are merged.
    pub merge_rad: f32,
    /// Surfels in front of a stable surface that is seen, by more than this many metres …
    pub free_m: f32,
    /// … and so many standard deviations of depth, are removed.
    pub free_deviations: f32,
    /// What becomes of objects that move.
    pub dynamics: DynamicsSettings,
}

/// How objects that move are found, whose surfels become unstable then (Keller et al. 2013, section on dynamics): where measurements stand in front
/// of what is known, and where they see through it, grown over surfaces in cells of the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct DynamicsSettings {
    /// Whether objects that move are looked for.
    pub enabled: bool,
    /// What moves starts where measurements stand in front of stable surfels by more than this many metres …
    pub gate_m: f32,
    /// … and so many standard deviations of depth (a Kinect's) more.
    pub gate_deviations: f32,
    /// Pixels to a side of the finest cells.
    pub cell_px: u32,
    /// Levels of cells, each of twice the size of the one before.
    pub levels: u32,
    /// Share of a cell's measurements that must disagree with the map for the cell to do so.
    pub min_share: f32,
    /// So many times the outermost of the finest cells are taken away from what disagrees: what is not wider than twice as many cells
    /// is noise.
    pub erosion: u32,
    /// Steps of growing on each level.
    pub iterations: u32,
    /// What moves grows over cells whose places lie within this many metres of each other's planes …
    pub alike_m: f32,
    /// … and so many standard deviations of depth more …
    pub alike_deviations: f32,
    /// … and whose normals differ by at most this angle in radians.
    pub alike_rad: f32,
    /// Confidence that is left to stable surfels of what moves or has left; surfels of as much count where measurements see through them.
    pub fallen: f32,
}

impl Default for DynamicsSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            gate_m: 0.03,
            gate_deviations: 3.0,
            cell_px: 4,
            levels: 3,
            min_share: 0.3,
            erosion: 1,
            iterations: 8,
            alike_m: 0.01,
            alike_deviations: 2.0,
            alike_rad: 0.35,
            fallen: 1.0,
        }
    }
}

impl Default for SurfelSettings {
    fn default() -> Self {
        Self {
            initial: 1 << 18,
            device_budget_mib: 0.0,
            radius_factor: 1.0,
            confidence_sigma: 0.6,
            stable: 10.0,
            max_confidence: 100.0,
            patience: 30,
            forget_after: 3000,
            track_from: 3.0,
            all_for: 20,
            window_m: 0.01,
            window_deviations: 2.0,
            max_angle_rad: 1.0,
            normal_reach_px: 3,
            max_slant_rad: 1.5,
            coarser: 1.5,
            finer: 2.0,
            reach: 1.0,
            overlap: 1.5,
            merge_m: 0.01,
            merge_rad: 0.35,
            free_m: 0.03,
            free_deviations: 3.0,
            dynamics: DynamicsSettings::default(),
        }
    }
}

impl SurfelSettings {
    /// Checks every value's range.
    ///
    /// # Errors
    /// The first value out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let count = |key, value: u32, most: u32| {
            check((1..=most).contains(&value), key, "a whole number from 1 to 16 million, or 64 pixels", value)
        };
        count("surfels.initial", self.initial, 1 << 24)?;
        count("surfels.patience", self.patience, 1 << 24)?;
        count("surfels.normal_reach_px", self.normal_reach_px, 64)?;
        check(self.all_for <= 1 << 24, "surfels.all_for", "at most 16 million", self.all_for)?;
        check(
            (0.0..=1e9).contains(&self.device_budget_mib),
            "surfels.device_budget_mib",
            "between 0 and 1e9",
            self.device_budget_mib,
        )?;
        for (key, value, least, most, expected) in [
            ("surfels.radius_factor", self.radius_factor, 0.01, 100.0, "between 0.01 and 100"),
            ("surfels.confidence_sigma", self.confidence_sigma, 0.01, 100.0, "between 0.01 and 100"),
            ("surfels.stable", self.stable, 0.01, 1e6, "between 0.01 and a million"),
            ("surfels.max_confidence", self.max_confidence, self.stable, 1e6, "between surfels.stable and a million"),
            ("surfels.track_from", self.track_from, 0.0, self.stable, "between 0 and surfels.stable"),
            ("surfels.window_m", self.window_m, 1e-6, 10.0, "above 0, at most 10"),
            ("surfels.window_deviations", self.window_deviations, 0.0, 100.0, "between 0 and 100"),
            ("surfels.max_angle_rad", self.max_angle_rad, 0.01, 1.57, "between 0.01 and 1.57"),
            ("surfels.max_slant_rad", self.max_slant_rad, 0.01, 1.57, "between 0.01 and 1.57"),
            ("surfels.coarser", self.coarser, 1.0, 100.0, "between 1 and 100"),
            ("surfels.finer", self.finer, 1.0, 100.0, "between 1 and 100"),
            ("surfels.reach", self.reach, 0.1, 10.0, "between 0.1 and 10"),
            ("surfels.overlap", self.overlap, 0.1, 10.0, "between 0.1 and 10"),
            ("surfels.merge_m", self.merge_m, 0.0, 10.0, "between 0 and 10"),
            ("surfels.merge_rad", self.merge_rad, 0.0, 1.57, "between 0 and 1.57"),
            ("surfels.free_m", self.free_m, 0.0, 10.0, "between 0 and 10"),
            ("surfels.free_deviations", self.free_deviations, 0.0, 100.0, "between 0 and 100"),
        ] {
            check((least..=most).contains(&value), key, expected, value)?;
        }
        self.dynamics.validate(self.stable)
    }
}

impl DynamicsSettings {
    /// Checks every value's range, given the confidence from which on surfels are stable.
    fn validate(&self, stable: f32) -> Result<(), SettingsError> {
        let most_fallen = if self.enabled { stable } else { 1e6 };
        for (key, value, least, most, expected) in [
            ("surfels.dynamics.cell_px", self.cell_px, 1, 256, "a whole number from 1 to 256"),
            ("surfels.dynamics.levels", self.levels, 1, 8, "a whole number from 1 to 8"),
            ("surfels.dynamics.erosion", self.erosion, 0, 16, "at most 16"),
            ("surfels.dynamics.iterations", self.iterations, 0, 256, "at most 256"),
        ] {
            check((least..=most).contains(&value), key, expected, value)?;
        }
        for (key, value, least, most, expected) in [
            ("surfels.dynamics.gate_m", self.gate_m, 0.0, 10.0, "between 0 and 10"),
            ("surfels.dynamics.gate_deviations", self.gate_deviations, 0.0, 100.0, "between 0 and 100"),
            ("surfels.dynamics.min_share", self.min_share, 0.0, 1.0, "between 0 and 1"),
            ("surfels.dynamics.alike_m", self.alike_m, 0.0, 10.0, "between 0 and 10"),
            ("surfels.dynamics.alike_deviations", self.alike_deviations, 0.0, 100.0, "between 0 and 100"),
            ("surfels.dynamics.alike_rad", self.alike_rad, 0.0, 1.57, "between 0 and 1.57"),
            ("surfels.dynamics.fallen", self.fallen, 1e-3, most_fallen, "between 0.001 and surfels.stable"),
        ] {
            check((least..=most).contains(&value), key, expected, value)?;
        }
        Ok(())
    }
}
