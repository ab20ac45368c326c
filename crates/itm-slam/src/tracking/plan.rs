//! What a kind of tracker evaluates at which level, and when it stops.

use itm_core::{DepthWeight, ExtendedSettings, IcpSettings, RgbSettings, Settings};
use itm_gpu::icp::DepthTerm;
use itm_gpu::photometric::PhotometricTerm;

use super::{Against, Request};

/// Which parts of the pose a level estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Rotation.
    Rotation,
    /// Translation.
    Translation,
    /// Both.
    Both,
}

impl Part {
    /// By its letter in settings; `None` for `n`, nothing.
    fn from_letter(letter: char) -> Option<Self> {
        match letter {
            'r' => Some(Self::Rotation),
            't' => Some(Self::Translation),
            'n' => None,
            _ => Some(Self::Both),
        }
    }

    /// The unknowns that are estimated (translation 0 to 2, rotation 3 to 5).
    pub fn unknowns(self) -> std::ops::Range<usize> {
        match self {
            Self::Rotation => 3..6,
            Self::Translation => 0..3,
            Self::Both => 0..6,
        }
    }
}

/// One level of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelPlan {
    /// What is estimated.
    pub part: Part,
    /// What is evaluated. A colour term's cutoff is its largest; that which follows from the noise may be smaller.
    pub request: Request,
    /// Largest number of steps.
    pub max_steps: u32,
    /// Whether it is the plan's last, where images are nearly aligned.
    pub finest: bool,
}

/// What is evaluated from coarse to fine, and when each level ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// From coarse to fine; levels that estimate nothing are left out.
    pub levels: Vec<LevelPlan>,
    /// Letters in the settings, those for nothing included.
    pub letters: usize,
    /// A level ends when a step moves less than this (metres and radians).
    pub min_step: f64,
    /// A level ends when a step lowers the cost by a smaller share than this.
    pub min_decrease: f64,
    /// How much colour counts beside depth.
    pub colour_weight: f64,
    /// Information (see `tracker.min_information`) with which depth alone is enough, so that colour counts for less.
    pub enough_information: Option<f64>,
    /// Whether exposures are estimated.
    pub estimate_exposure: bool,
    /// Colour differences of so many standard deviations no longer count.
    pub tukey_cutoff: f64,
    /// Motion in directions less determined than this (see `tracker.min_information`) is held.
    pub min_information: Option<f64>,
    /// Fewest pairs from which a pose is estimated.
    pub min_pairs: u32,
    /// Root mean square residual in metres beyond which tracking has failed.
    pub max_rms_m: Option<f64>,
}

/// How old the map is, which decides whether confidence counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Age {
    /// Frames that were fused.
    pub frames: u64,
}

/// A level's place: from 0 at the coarsest to 1 at the finest, and the pyramid's level.
fn places(letters: usize) -> impl Iterator<Item = (f32, usize)> {
    (0..letters).map(move |i| {
        let fine = if letters > 1 { i as f32 / (letters - 1) as f32 } else { 1.0 };
        (fine, letters - 1 - i)
    })
}

fn linear(fine: f32, coarse: f32, finest: f32) -> f32 {
    coarse + fine * (finest - coarse)
}

fn geometric(fine: f32, coarse: f32, finest: f32) -> f32 {
    coarse * (finest / coarse).powf(fine)
}

fn steps(fine: f32, coarse: u32, finest: u32) -> u32 {
    linear(fine, coarse as f32, finest as f32).round() as u32
}

fn failure(max_rms_mm: f64) -> Option<f64> {
    (max_rms_mm > 0.0).then_some(max_rms_mm * 1e-3)
}

impl Plan {
    /// For equations of an evaluation that no optimisation follows.
    pub(crate) fn of_check() -> Self {
        Self {
            levels: Vec::new(),
            letters: 0,
            min_step: 0.0,
            min_decrease: 0.0,
            colour_weight: 0.0,
            enough_information: None,
            estimate_exposure: false,
            tukey_cutoff: f64::INFINITY,
            min_information: None,
            min_pairs: 0,
            max_rms_m: None,
        }
    }

    /// Point-to-plane ICP, with levels of its own or the settings'.
    pub(crate) fn icp(settings: &Settings, icp: &IcpSettings, levels: &str) -> Self {
        let level = |((fine, level), letter): ((f32, usize), char)| {
            let max_distance_m = linear(fine, icp.max_distance_coarse_m, icp.max_distance_fine_m);
            Some(LevelPlan {
                part: Part::from_letter(letter)?,
                request: Request { level, depth: Some(DepthTerm::plain(max_distance_m)), colour: [None; 2] },
                max_steps: steps(fine, icp.max_steps_coarse, icp.max_steps_fine),
                finest: level == 0,
            })
        };
        Self {
            levels: places(levels.len()).zip(levels.chars()).filter_map(level).collect(),
            letters: levels.len(),
            min_step: icp.min_step,
            min_decrease: 0.0,
            colour_weight: 0.0,
            enough_information: None,
            estimate_exposure: false,
            tukey_cutoff: f64::INFINITY,
            min_information: min_information(settings),
            min_pairs: 100,
            max_rms_m: failure(icp.max_rms_mm),
        }
    }

    /// Robust alignment of depth and colour together, with levels of its own or the settings'.
    pub(crate) fn extended(settings: &Settings, extended: &ExtendedSettings, levels: &str, age: Age) -> Self {
        let e = extended;
        let depth_range_m = [settings.view.min_depth_m, settings.view.max_depth_m];
        let weighted = age.frames >= u64::from(e.frames_to_weight);
        let skipping = age.frames >= u64::from(e.frames_to_skip);
        let level = |((fine, level), letter): ((f32, usize), char)| {
            let max_plane = geometric(fine, e.max_plane_distance_coarse_m, e.max_plane_distance_fine_m);
            let depth = e.use_depth.then_some(DepthTerm {
                // Points that slide along their surface stay pairs; those of another surface do not.
                max_distance_m: 3.0 * max_plane + 0.05,
                max_plane_distance_m: max_plane,
                huber_m: e.huber_share * max_plane,
                weight: e.depth_weight,
                depth_range_m,
                full_confidence: if weighted { e.full_confidence as f32 } else { 0.0 },
                least_confidence: if skipping { 2.0 } else { 0.0 },
                stride: 1,
            });
            let colour_level = level.max(e.finest_colour_level as usize);
            let colour = PhotometricTerm {
                cutoff: geometric(fine, e.max_colour_difference_coarse, e.max_colour_difference_fine),
                gain: 1.0,
                offset: 0.0,
                least_gradient: e.min_colour_gradient,
                weight: DepthWeight::None,
                depth_range_m,
                level: colour_level,
                rgb: false,
            };
            let mut terms = [None; 2];
            terms[Against::Previous as usize] = e.use_colour.then_some(colour);
            terms[Against::Map as usize] = e.use_map_colour.then_some(colour);
            Some(LevelPlan {
                part: Part::from_letter(letter)?,
                request: Request { level, depth, colour: terms },
                max_steps: steps(fine, e.max_steps_coarse, e.max_steps_fine),
                finest: level == 0,
            })
        };
        Self {
            levels: places(levels.len()).zip(levels.chars()).filter_map(level).collect(),
            letters: levels.len(),
            min_step: e.min_step,
            min_decrease: 0.0,
            colour_weight: e.colour_weight,
            enough_information: (e.enough_information > 0.0).then_some(e.enough_information),
            estimate_exposure: e.estimate_exposure,
            tukey_cutoff: e.tukey_cutoff.into(),
            min_information: min_information(settings),
            min_pairs: e.min_pairs,
            max_rms_m: failure(e.max_rms_mm),
        }
    }

    /// Colour of surface points against the live image.
    pub(crate) fn rgb(settings: &Settings, rgb: &RgbSettings) -> Self {
        let level = |((_, level), letter): ((f32, usize), char)| {
            let mut colour = [None; 2];
            colour[Against::Map as usize] = Some(PhotometricTerm {
                cutoff: rgb.max_difference,
                gain: 1.0,
                offset: 0.0,
                least_gradient: 0.0,
                weight: DepthWeight::None,
                depth_range_m: [settings.view.min_depth_m, settings.view.max_depth_m],
                level,
                rgb: true,
            });
            Some(LevelPlan {
                part: Part::from_letter(letter)?,
                request: Request { level, depth: None, colour },
                max_steps: rgb.max_steps,
                finest: level == 0,
            })
        };
        Self {
            levels: places(rgb.levels.len()).zip(rgb.levels.chars()).filter_map(level).collect(),
            letters: rgb.levels.len(),
            min_step: rgb.min_step,
            min_decrease: rgb.min_decrease,
            colour_weight: 1.0,
            enough_information: None,
            estimate_exposure: false,
            tukey_cutoff: f64::INFINITY,
            min_information: min_information(settings),
            min_pairs: 100,
            max_rms_m: None,
        }
    }
}

fn min_information(settings: &Settings) -> Option<f64> {
    settings.tracker.hold_degenerate.then_some(settings.tracker.min_information)
}
