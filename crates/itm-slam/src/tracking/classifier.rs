//! A classifier over what one evaluation at a pose shows, in the manner of Kähler et al. 2016 (*Real-Time Large-Scale Dense
//! 3D Reconstruction with Loop Closure*, section 2.2).
//!
//! The evaluation is the same whichever tracker found the pose, so that one classifier serves all. It is a logistic
//! regression over the features below, their squares and products, trained on labelled synthetic recordings; see
//! `assets/verdict.toml`, which says by which command.

use std::sync::LazyLock;

use itm_core::{DepthWeight, Intrinsics, Se3};
use itm_gpu::DepthSums;
use itm_gpu::icp::DepthTerm;
use serde::{Deserialize, Serialize};

use super::{Evaluation, Noise, NormalEquations, Plan, Request};

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

/// How many of them, the first, are about what is seen at the pose; the others are about the jump there.
pub const SEEN_FEATURES: usize = 7;

/// What the classifier looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Features {
    /// How what is seen at the pose agrees with the map.
    pub seen: [f64; SEEN_FEATURES],
    /// How far the pose is from where the camera was expected; none where that is in doubt itself.
    pub jump: Option<[f64; FEATURES - SEEN_FEATURES]>,
}

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
    pub(crate) fn new(sums: &DepthSums, pixels: usize, pose: &Se3, expected: Option<&Se3>) -> Option<Self> {
        if sums.count == 0 || sums.weights <= 0.0 {
            return None;
        }
        let evaluation = Evaluation { depth: Some(*sums), colour: [None; 2] };
        let plan = Plan::of_check();
        let equations =
            NormalEquations::new(&evaluation, &check(0), &plan, &Noise { depth_m: 1.0, ..Noise::default() }, 0.0);
        let valid = f64::from(sums.valid);
        let (count, in_front, behind) = (f64::from(sums.count), f64::from(sums.in_front), f64::from(sums.behind));
        let seen = [
            count / valid,
            in_front / valid,
            behind / valid,
            1.0 - (count + in_front + behind) / valid,
            valid / pixels as f64,
            ((2.0 * sums.cost / sums.weights).sqrt() * 1e3).max(0.05).ln(),
            equations.information()[0].max(1e-7).ln(),
        ];
        let jump = expected.map(|expected| {
            let jump = expected.inverse() * *pose;
            [(1.0 + jump.translation.length() / 0.01).ln(), (1.0 + jump.angle().to_degrees() / 0.5).ln()]
        });
        let features = Self { seen, jump };
        features.values().all(f64::is_finite).then_some(features)
    }

    /// Those that there are, in their order.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.seen.into_iter().chain(self.jump.into_iter().flatten())
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
    /// Over all features, where the frames before were good.
    pub expected: Regression,
    /// Over what is seen alone. After a loss the camera is expected where it was last taken to be: wrong poses that follow each
    /// other are no jump.
    pub in_doubt: Regression,
}

/// What was learnt over some of the features.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Regression {
    /// A frame is good where the chance that its pose is wrong is at most this.
    pub good_below: f64,
    /// A frame is lost where the chance is larger than this.
    pub lost_above: f64,
    /// In the order of [`terms`].
    pub weights: Vec<f64>,
}

/// Bound of a standardised feature: what was never seen in training must not be extrapolated quadratically.
const LARGEST_SCORE: f64 = 4.0;

/// The terms of the regression for standardised features: the constant, the features, and their squares and products.
pub fn terms(standard: &[f64]) -> Vec<f64> {
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
    pub fn standardise(&self, features: &Features) -> Vec<f64> {
        let of = |(value, (mean, scale)): (f64, (&f64, &f64))| (value - mean) / scale;
        let scores = features.values().zip(self.mean.iter().zip(&self.scale)).map(of);
        scores.map(|score| score.clamp(-LARGEST_SCORE, LARGEST_SCORE)).collect()
    }

    /// What was learnt over such features.
    pub fn regression(&self, features: &Features) -> &Regression {
        if features.jump.is_some() { &self.expected } else { &self.in_doubt }
    }

    /// The chance that a pose is wrong by more than 5 cm or 5 degrees.
    pub fn chance_wrong(&self, features: &Features) -> f64 {
        let terms = terms(&self.standardise(features));
        let score: f64 = terms.iter().zip(&self.regression(features).weights).map(|(t, w)| t * w).sum();
        1.0 / (1.0 + (-score).exp())
    }

    /// What is unusual about features, in words and numbers.
    pub(crate) fn unusual(&self, features: &Features) -> Vec<String> {
        DESCRIPTIONS
            .iter()
            .zip(features.values().zip(self.usual))
            .filter_map(|(d, (value, [low, high]))| {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_classifier_that_is_shipped_reads() {
        let classifier = Classifier::trained();
        assert!(classifier.scale.iter().all(|s| *s > 0.0));
        for (regression, features) in [(&classifier.expected, FEATURES), (&classifier.in_doubt, SEEN_FEATURES)] {
            assert_eq!(regression.weights.len(), terms(&vec![0.0; features]).len());
            assert!(regression.good_below <= regression.lost_above);
        }
    }

    #[test]
    fn what_the_map_contradicts_is_wrong_and_what_it_confirms_is_right() {
        let classifier = Classifier::trained();
        let good = [0.92, 0.02, 0.02, 0.04, 0.9, 0.6, (0.05_f64).ln()];
        let wrong = [0.25, 0.3, 0.3, 0.15, 0.9, 2.5, (0.02_f64).ln()];
        for (good_jump, wrong_jump) in [(Some([0.3, 0.3]), Some([3.5, 3.5])), (None, None)] {
            let good = Features { seen: good, jump: good_jump };
            let wrong = Features { seen: wrong, jump: wrong_jump };
            let regression = classifier.regression(&good);
            assert!(classifier.chance_wrong(&good) < regression.good_below);
            assert!(classifier.chance_wrong(&wrong) > regression.lost_above);
            let reasons = classifier.unusual(&wrong).join("; ");
            assert!(reasons.contains("points that agree with the map: 25 %, usually at least"), "{reasons}");
            assert_eq!(reasons.contains("jump"), wrong_jump.is_some(), "{reasons}");
        }
    }

    #[test]
    fn after_a_loss_wrong_poses_that_follow_each_other_are_not_good() {
        // Tracked for the third time beside a place that was found after a hand had covered the lens: 24 cm off.
        let classifier = Classifier::trained();
        let seen = [0.505, 0.040, 0.055, 0.400, 0.986, 2.279, -4.195];
        let followed = Features { seen, jump: Some([0.557, 0.101]) };
        assert!(classifier.chance_wrong(&followed) < classifier.regression(&followed).good_below);
        let in_doubt = Features { seen, jump: None };
        assert!(classifier.chance_wrong(&in_doubt) > classifier.regression(&in_doubt).good_below);
        // The right pose, of a view of which the map shows half.
        let right = Features { seen: [0.528, 0.0, 0.003, 0.468, 0.986, 2.087, -4.312], jump: None };
        assert!(classifier.chance_wrong(&right) < classifier.regression(&right).good_below);
    }
}
