//! Whether a pose can be relied on, and why not.

use itm_core::{Se3, VerdictSettings};
use nalgebra::Matrix6;

use super::classifier::{Classifier, Features};
use super::{Evaluation, Plan};

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
    /// What the classifier looked at, where it could.
    pub features: Option<Features>,
    /// Pairs at the end of the finest level that was used.
    pub inliers: u32,
    /// Pairs as a share of the pixels with a depth.
    pub inlier_share: f64,
    /// Root mean square distance of the pairs from their planes, in metres.
    pub rms_m: f64,
    /// How well the least determined direction is determined; see [`NormalEquations::information`](super::NormalEquations::information).
    pub information: f64,
    /// Directions of motion that were held.
    pub held: usize,
    /// Covariance of the estimate's error, as a twist in the camera's own axes (metres, then radians): of the sensor's noise
    /// alone, as the equations have it. Zeros where the pose was not estimated.
    pub covariance: Matrix6<f64>,
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
            features: None,
            inliers: 0,
            inlier_share: 0.0,
            rms_m: f64::INFINITY,
            information: 0.0,
            held: 0,
            covariance: Matrix6::zeros(),
            start: 0,
            evaluations: Vec::new(),
        }
    }
}

/// What a tracker ended with, and what is known for judging it.
pub(crate) struct Ended<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) outcome: &'a super::Outcome,
    /// The evaluation of [`check`](super::classifier::check) at the pose, and its number of pixels.
    pub(crate) checked: &'a Evaluation,
    pub(crate) pixels: usize,
    /// Where the camera was expected; none where that is in doubt.
    pub(crate) expected: Option<Se3>,
    /// The pose to hold where tracking was lost.
    pub(crate) held: Se3,
}

/// The classifier's verdict, and the chance that the pose is wrong.
fn classified(settings: &VerdictSettings, features: &Features) -> (Verdict, f64) {
    let classifier = Classifier::trained();
    let (chance_wrong, regression) = (classifier.chance_wrong(features), classifier.regression(features));
    let or_trained = |setting: f64, trained: f64| if setting > 0.0 { setting } else { trained };
    let verdict = if chance_wrong > or_trained(settings.lost_above, regression.lost_above) {
        Verdict::Lost
    } else if chance_wrong > or_trained(settings.good_below, regression.good_below) {
        Verdict::Poor
    } else {
        Verdict::Good
    };
    (verdict, chance_wrong)
}

/// The verdict on where a tracker ended.
pub(crate) fn judge(settings: &VerdictSettings, ended: &Ended<'_>) -> Tracked {
    let Ended { plan, outcome, checked, pixels, expected, held } = ended;
    let estimate = outcome.guess.world_from_camera;
    let finite = if estimate.is_finite() { estimate } else { *held };
    let depth = outcome.last.depth;
    let (count, valid, squares) = depth.map_or((0, 0, 0.0), |d| (d.count, d.valid, d.squares));
    // A tracker that compares depth must find it: what colour says beside it does not show that the map is right.
    let colour_pairs = outcome.last.colour.iter().flatten().map(|c| c.count).sum::<u32>();
    let pairs = if depth.is_some() { count } else { colour_pairs };
    let rms_m = (squares / f64::from(count)).sqrt();
    let features = checked.depth.and_then(|sums| Features::new(&sums, *pixels, &finite, expected.as_ref()));
    let seen = checked.depth.map_or(0, |d| d.valid);
    let mut reasons = Vec::new();
    if seen == 0 {
        reasons.push("no pixel has a depth within the view's range".into());
    } else if pairs < plan.min_pairs {
        reasons.push(format!("{pairs} points agree with the map, at least {} are needed", plan.min_pairs));
    } else if features.is_none() {
        reasons.push("no point agrees with the map".into());
    }
    if !estimate.is_finite() {
        reasons.push("the pose is not finite".into());
    }
    if let Some(limit) = plan.max_rms_m.filter(|limit| rms_m > *limit) {
        reasons.push(format!("residual: {:.1} mm, the setting allows {:.1} mm", rms_m * 1e3, limit * 1e3));
    }
    let mut verdict = if reasons.is_empty() { Verdict::Good } else { Verdict::Lost };
    let mut chance_wrong = if reasons.is_empty() { 0.0 } else { 1.0 };
    if let (Verdict::Good, Some(features), true) = (verdict, &features, settings.classify) {
        (verdict, chance_wrong) = classified(settings, features);
        if verdict != Verdict::Good {
            reasons.push(format!("the pose is wrong with a chance of {:.0} %", 100.0 * chance_wrong));
            reasons.extend(Classifier::trained().unusual(features));
        }
    }
    Tracked {
        world_from_camera: if verdict == Verdict::Lost { *held } else { finite },
        estimate: finite,
        verdict,
        reasons,
        chance_wrong,
        features,
        inliers: count,
        inlier_share: if valid == 0 { 0.0 } else { f64::from(count) / f64::from(valid) },
        rms_m,
        information: outcome.equations.as_ref().map_or(0.0, |e| e.information()[0]),
        held: outcome.held,
        covariance: outcome.equations.as_ref().map_or_else(Matrix6::zeros, |e| e.covariance(&finite)),
        start: outcome.start,
        evaluations: outcome.evaluations.clone(),
    }
}
