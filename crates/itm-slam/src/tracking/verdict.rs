//! Whether a pose can be relied on: a classifier over what one evaluation at the pose shows, in the manner of Kähler et al.
//! 2016 (*Real-Time Large-Scale Dense 3D Reconstruction with Loop Closure*, section 2.2).
//!
//! The evaluation is the same whichever tracker found the pose, so that one classifier serves all. It is a logistic
//! regression over the features below, their squares and products, trained on labelled synthetic recordings; see
//! `assets/verdict.toml`, which says by which command.

use std::sync::LazyLock;

use itm_core::{DepthWeight, Intrinsics, Se3, VerdictSettings};
use itm_gpu::DepthSums;
use itm_gpu::icp::DepthTerm;
use serde::{Deserialize, Serialize};

use super::{Evaluation, Noise, NormalEquations, Plan, Request};

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
    /// How well the least determined direction is determined; see [`NormalEquations::information`].
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
            features: None,
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

/// What is evaluated at a pose for its verdict, whichever tracker found it.
pub(crate) fn check(level: usize) -> Request {
    let depth = DepthTerm {
        max_distance_m: 0.15,
        max_plane_distance_m: 0.04,
        huber_m: 0.02,
        weight: DepthWeight::Noise,
        ..DepthTerm::plain(0.15)
    };
    Request { level, depth: Some(depth), colour: [None; 2] }
}

/// Levels that a view has for verdicts' sake.
pub(crate) const CHECK_LEVELS: usize = 3;

/// The level of a depth pyramid at which verdicts are found: the finest one not wider than 320 pixels, if a view has it.
pub(crate) fn check_level(camera: &Intrinsics) -> usize {
    (0..CHECK_LEVELS).find(|l| camera.at_level(*l as u32).width <= 320).unwrap_or(CHECK_LEVELS - 1)
}

/// Number of features.
pub const FEATURES: usize = 9;

/// What the classifier looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Features(pub [f64; FEATURES]);

/// A feature's name, how its value reads, and whether large values are the bad ones.
struct Description {
    name: &'static str,
    text: fn(f64) -> String,
    bad_when_large: bool,
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

const DESCRIPTIONS: [Description; FEATURES] = [
    Description { name: "points that agree with the map", text: percent, bad_when_large: false },
    Description { name: "points in front of the map's surface", text: percent, bad_when_large: true },
    Description { name: "points behind the map's surface", text: percent, bad_when_large: true },
    Description { name: "points where the map shows nothing", text: percent, bad_when_large: true },
    Description { name: "pixels with a depth", text: percent, bad_when_large: false },
    Description { name: "residual", text: |v| format!("{:.1} mm", v.exp()), bad_when_large: true },
    Description {
        name: "information on the least determined direction",
        text: |v| format!("{:.4}", v.exp()),
        bad_when_large: false,
    },
    Description {
        name: "jump away from the expected position",
        text: |v| format!("{:.0} mm", 10.0 * (v.exp() - 1.0)),
        bad_when_large: true,
    },
    Description {
        name: "jump away from the expected direction",
        text: |v| format!("{:.1}°", 0.5 * (v.exp() - 1.0)),
        bad_when_large: true,
    },
];

impl Features {
    /// Of an evaluation of [`check`] over so many pixels, at a pose, where another was expected.
    fn new(sums: &DepthSums, pixels: usize, pose: &Se3, expected: &Se3) -> Option<Self> {
        if sums.count == 0 || sums.weights <= 0.0 {
            return None;
        }
        let evaluation = Evaluation { depth: Some(*sums), colour: [None; 2] };
        let plan = Plan::of_check();
        let equations =
            NormalEquations::new(&evaluation, &check(0), &plan, &Noise { depth_m: 1.0, ..Noise::default() }, 0.0);
        let valid = f64::from(sums.valid);
        let (count, in_front, behind) = (f64::from(sums.count), f64::from(sums.in_front), f64::from(sums.behind));
        let jump = expected.inverse() * *pose;
        let features = [
            count / valid,
            in_front / valid,
            behind / valid,
            1.0 - (count + in_front + behind) / valid,
            valid / pixels as f64,
            ((2.0 * sums.cost / sums.weights).sqrt() * 1e3).max(0.05).ln(),
            equations.information()[0].max(1e-7).ln(),
            (1.0 + jump.translation.length() / 0.01).ln(),
            (1.0 + jump.angle().to_degrees() / 0.5).ln(),
        ];
        features.iter().all(|v| v.is_finite()).then_some(Self(features))
    }
}

/// A trained classifier: logistic regression over standardised features, their squares and products.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Classifier {
    /// Of each feature over the training set.
    pub mean: [f64; FEATURES],
    /// Standard deviation of each feature.
    pub scale: [f64; FEATURES],
    /// Values of each feature that one in a hundred frames with right poses falls below, and above.
    pub usual: [[f64; 2]; FEATURES],
    /// For the constant, the features, then the products in the order of [`terms`].
    pub weights: Vec<f64>,
    /// A frame is good where the chance that its pose is wrong is at most this.
    pub good_below: f64,
    /// A frame is lost where the chance is larger than this.
    pub lost_above: f64,
}

/// Bound of a standardised feature: what was never seen in training must not be extrapolated quadratically.
const LARGEST_SCORE: f64 = 4.0;

/// The terms of the regression for standardised features: the constant, the features, and their squares and products.
pub fn terms(standard: &[f64; FEATURES]) -> Vec<f64> {
    let mut terms = vec![1.0];
    terms.extend(standard);
    for (i, a) in standard.iter().enumerate() {
        terms.extend(standard[i..].iter().map(|b| a * b));
    }
    terms
}

static TRAINED: LazyLock<Classifier> = LazyLock::new(|| {
    toml::from_str(itm_assets::VERDICT).expect("the classifier that the crate ships reads, which a test checks")
});

impl Classifier {
    /// The classifier that comes with the crate.
    pub fn trained() -> &'static Self {
        &TRAINED
    }

    /// Features as multiples of their standard deviations from their means.
    pub fn standardise(&self, features: &Features) -> [f64; FEATURES] {
        std::array::from_fn(|i| ((features.0[i] - self.mean[i]) / self.scale[i]).clamp(-LARGEST_SCORE, LARGEST_SCORE))
    }

    /// The chance that a pose is wrong by more than 5 cm or 5 degrees.
    pub fn chance_wrong(&self, features: &Features) -> f64 {
        let terms = terms(&self.standardise(features));
        let score: f64 = terms.iter().zip(&self.weights).map(|(t, w)| t * w).sum();
        1.0 / (1.0 + (-score).exp())
    }

    /// What is unusual about features, in words and numbers.
    fn unusual(&self, features: &Features) -> Vec<String> {
        DESCRIPTIONS
            .iter()
            .enumerate()
            .filter_map(|(i, d)| {
                let (value, [low, high]) = (features.0[i], self.usual[i]);
                if d.bad_when_large && value > high {
                    Some(format!("{}: {}, usually at most {}", d.name, (d.text)(value), (d.text)(high)))
                } else if !d.bad_when_large && value < low {
                    Some(format!("{}: {}, usually at least {}", d.name, (d.text)(value), (d.text)(low)))
                } else {
                    None
                }
            })
            .collect()
    }
}

/// What a tracker ended with, and what is known for judging it.
pub(crate) struct Ended<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) outcome: &'a super::Outcome,
    /// The evaluation of [`check`] at the pose, and its number of pixels.
    pub(crate) checked: &'a Evaluation,
    pub(crate) pixels: usize,
    /// Where the camera was expected.
    pub(crate) expected: Se3,
    /// The pose to hold where tracking was lost.
    pub(crate) held: Se3,
}

/// The verdict on where a tracker ended.
pub(crate) fn judge(settings: &VerdictSettings, ended: &Ended<'_>) -> Tracked {
    let Ended { plan, outcome, checked, pixels, expected, held } = ended;
    let estimate = outcome.guess.world_from_camera;
    let finite = if estimate.is_finite() { estimate } else { *held };
    let depth = outcome.last.depth;
    let (count, valid, squares) = depth.map_or((0, 0, 0.0), |d| (d.count, d.valid, d.squares));
    let pairs = count + outcome.last.colour.iter().flatten().map(|c| c.count).sum::<u32>();
    let rms_m = (squares / f64::from(count)).sqrt();
    let classifier = Classifier::trained();
    let features = checked.depth.and_then(|sums| Features::new(&sums, *pixels, &finite, expected));
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
        chance_wrong = classifier.chance_wrong(features);
        let or_trained = |setting: f64, trained: f64| if setting > 0.0 { setting } else { trained };
        if chance_wrong > or_trained(settings.lost_above, classifier.lost_above) {
            verdict = Verdict::Lost;
        } else if chance_wrong > or_trained(settings.good_below, classifier.good_below) {
            verdict = Verdict::Poor;
        }
        if verdict != Verdict::Good {
            reasons.push(format!("the pose is wrong with a chance of {:.0} %", 100.0 * chance_wrong));
            reasons.extend(classifier.unusual(features));
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
        start: outcome.start,
        evaluations: outcome.evaluations.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_classifier_that_is_shipped_reads() {
        let classifier = Classifier::trained();
        assert_eq!(classifier.weights.len(), terms(&[0.0; FEATURES]).len());
        assert!(classifier.scale.iter().all(|s| *s > 0.0));
        assert!(classifier.good_below <= classifier.lost_above);
    }

    #[test]
    fn what_the_map_contradicts_is_wrong_and_what_it_confirms_is_right() {
        let classifier = Classifier::trained();
        let good = Features([0.92, 0.02, 0.02, 0.04, 0.9, 0.6, (0.05_f64).ln(), 0.3, 0.3]);
        let wrong = Features([0.25, 0.3, 0.3, 0.15, 0.9, 2.5, (0.02_f64).ln(), 3.5, 3.5]);
        assert!(classifier.chance_wrong(&good) < classifier.good_below);
        assert!(classifier.chance_wrong(&wrong) > classifier.lost_above);
        let reasons = classifier.unusual(&wrong).join("; ");
        assert!(reasons.contains("points that agree with the map: 25 %, usually at least"), "{reasons}");
    }
}
