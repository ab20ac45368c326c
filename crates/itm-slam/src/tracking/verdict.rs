//! Whether a pose can be relied on.

use itm_core::{Frame, Se3, VerdictSettings};

use super::{Motion, Outcome, Plan};

/// Whether a pose can be relied on; better ones are less.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// It can.
    Good,
    /// It may be off, and is better not used for the map.
    Poor,
    /// It cannot.
    Lost,
}

impl Verdict {
    /// As it stands in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor => "poor",
            Self::Lost => "lost",
        }
    }
}

/// What tracking found.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracked {
    /// The camera's pose; where tracking was lost, the last one that could be relied on. Always finite.
    pub world_from_camera: Se3,
    /// What the optimisation ended with, whatever the verdict. Always finite.
    pub estimate: Se3,
    /// Whether it can be relied on.
    pub verdict: Verdict,
    /// Why it is not good, in words and numbers.
    pub reasons: Vec<String>,
    /// The classifier's estimate of the chance that the pose is wrong by more than 5 cm or 5 degrees; 0 or 1 where it was not
    /// asked.
    pub chance_wrong: f64,
    /// Pairs at the end of the finest level that was used.
    pub inliers: u32,
    /// Pairs as a share of the pixels with a depth.
    pub inlier_share: f64,
    /// Root mean square distance of the pairs from their planes, in metres.
    pub rms_m: f64,
    /// How well the least determined direction is determined.
    pub information: f64,
    /// Directions of motion that were held.
    pub held: usize,
    /// Which start it came from.
    pub start: usize,
    /// Evaluations of the objective, from the coarsest level to the finest.
    pub evaluations: Vec<u32>,
}

impl Tracked {
    /// A pose that was not estimated.
    pub(crate) fn given(pose: Se3) -> Self {
        Self { verdict: Verdict::Good, reasons: Vec::new(), chance_wrong: 0.0, ..Self::lost(pose, String::new()) }
    }

    pub(crate) fn lost(held: Se3, reason: String) -> Self {
        Self {
            world_from_camera: held,
            estimate: held,
            verdict: Verdict::Lost,
            reasons: vec![reason],
            chance_wrong: 1.0,
            inliers: 0,
            inlier_share: 0.0,
            rms_m: f64::INFINITY,
            information: 0.0,
            held: 0,
            start: 0,
            evaluations: Vec::new(),
        }
    }
}

pub(crate) fn judge(
    _settings: &VerdictSettings,
    plan: &Plan,
    outcome: &Outcome,
    starts: &[Se3],
    motion: &Motion,
    _frame: &Frame,
) -> Tracked {
    let held = motion.last().or(starts.first().copied()).unwrap_or_default();
    let depth = outcome.last.depth;
    let (count, valid, squares) = depth.map_or((0, 0, 0.0), |d| (d.count, d.valid, d.squares));
    let colour: u32 = outcome.last.colour.iter().flatten().map(|c| c.count).sum();
    let share = if valid == 0 { 0.0 } else { f64::from(count) / f64::from(valid) };
    let mut reasons = Vec::new();
    if count + colour < plan.min_pairs {
        reasons.push(format!("{} points agree with the map, at least {} are needed", count + colour, plan.min_pairs));
    } else if depth.is_some() && share < 0.2 {
        reasons.push(format!("{:.0} % of the points agree with the map", 100.0 * share));
    }
    let estimate = outcome.guess.world_from_camera;
    if !estimate.is_finite() {
        reasons.push("the pose is not finite".into());
    }
    let verdict = if reasons.is_empty() { Verdict::Good } else { Verdict::Lost };
    let finite = if estimate.is_finite() { estimate } else { held };
    Tracked {
        world_from_camera: if verdict == Verdict::Lost { held } else { finite },
        estimate: finite,
        verdict,
        reasons,
        chance_wrong: 0.0,
        inliers: count,
        inlier_share: share,
        rms_m: (squares / f64::from(count)).sqrt(),
        information: outcome.equations.as_ref().map_or(0.0, |e| e.information()[0]),
        held: outcome.held,
        start: outcome.start,
        evaluations: outcome.evaluations.clone(),
    }
}
