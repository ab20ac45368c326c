//! How far a trajectory is from the truth: absolute trajectory error and relative pose error, as Sturm et al. 2012
//! (*A Benchmark for the Evaluation of RGB-D SLAM Systems*, section VI) define them.

use std::fmt;

use glam::{DQuat, DVec3};
use nalgebra::Matrix4;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Se3, StampedPose, Timestamp, Trajectory};

/// How far apart in time an estimated and a true pose may lie by default: 20 ms, as in the benchmark's own tools.
pub const DEFAULT_TOLERANCE_NS: i64 = 20_000_000;

/// Fewest pairs of poses that an alignment means something for.
const FEWEST_PAIRS: usize = 3;

/// Pairs each estimated pose with the true one nearest in time, as `(estimated, true)` in the order of time.
///
/// Estimated poses without a true one within `tolerance_ns` nanoseconds are left out. No pose is used twice: where
/// several estimated poses are nearest to the same true one, the nearest of them in time keeps it (the earlier of two
/// equally near).
pub fn associate(estimate: &Trajectory, truth: &Trajectory, tolerance_ns: i64) -> Vec<(StampedPose, StampedPose)> {
    let gap = |(e, t): &(StampedPose, StampedPose)| e.timestamp.0.abs_diff(t.timestamp.0);
    let mut pairs: Vec<(StampedPose, StampedPose)> = Vec::new();
    for pose in estimate.poses() {
        let Some(nearest) = truth.nearest(pose.timestamp, tolerance_ns) else { continue };
        let pair = (*pose, *nearest);
        // Both are in the order of time, so that rivals for a true pose follow each other.
        match pairs.last_mut() {
            Some(last) if last.1.timestamp == nearest.timestamp => {
                if gap(&pair) < gap(last) {
                    *last = pair;
                }
            }
            _ => pairs.push(pair),
        }
    }
    pairs
}

/// What a set of errors looks like; all in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorStatistics {
    /// Root of the mean square.
    pub rmse: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// The middle value, or the mean of the two middle ones.
    pub median: f64,
    /// Standard deviation about the mean, of the errors themselves (divided by their number).
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl ErrorStatistics {
    /// Statistics of at least one error, or `None` of none.
    pub fn new(mut errors: Vec<f64>) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let (&min, &max) = (errors.first()?, errors.last()?);
        let n = errors.len();
        let mean_of = |f: &dyn Fn(f64) -> f64| errors.iter().map(|&e| f(e)).sum::<f64>() / n as f64;
        let mean = mean_of(&|e| e);
        Some(Self {
            rmse: mean_of(&|e| e * e).sqrt(),
            mean,
            median: 0.5 * (errors[(n - 1) / 2] + errors[n / 2]),
            std: mean_of(&|e| (e - mean) * (e - mean)).sqrt(),
            min,
            max,
        })
    }
}

/// How far a trajectory is from the truth. Its [`Display`](fmt::Display) is a small table in millimetres and degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Evaluation {
    /// Estimated poses that have a true one; the errors are over these alone, so read them beside `estimate_poses`.
    pub pairs: usize,
    /// Poses of the estimate.
    pub estimate_poses: usize,
    /// Poses of the ground truth.
    pub truth_poses: usize,
    /// Length in metres of the true path through the paired poses.
    pub path_length_m: f64,
    /// Absolute trajectory error: distances in metres between true positions and estimated ones after alignment.
    pub ate: ErrorStatistics,
    /// Translational part of the relative pose error, in metres, of the motion from each pair to the next. That is
    /// from frame to frame but where frames in between have no pose or no truth.
    pub rpe_translation: ErrorStatistics,
    /// Rotational part of the relative pose error, in radians, of the same motions.
    pub rpe_rotation: ErrorStatistics,
    /// The alignment behind `ate`: takes the estimate's world to the ground truth's.
    pub truth_from_estimate: Se3,
}

/// Why a trajectory cannot be compared with the truth.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EvaluationError {
    /// A trajectory without poses.
    #[error("the {trajectory} has no poses")]
    Empty {
        /// `estimate` or `ground truth`.
        trajectory: &'static str,
    },
    /// A pose whose numbers are infinite, not numbers, or so large that their squares are.
    #[error("the {trajectory}'s pose at {timestamp} s is not finite or too far away to compare")]
    NotFinite {
        /// `estimate` or `ground truth`.
        trajectory: &'static str,
        /// The pose's time.
        timestamp: Timestamp,
    },
    /// Two trajectories that do not meet in time.
    #[error(
        "no estimated pose lies within {} ms of a true one: the estimate runs from {} s to {} s, the ground truth from {} s to {} s",
        *tolerance_ns as f64 * 1e-6, estimate.0, estimate.1, truth.0, truth.1
    )]
    NoAssociation {
        /// Largest distance in time allowed, in nanoseconds.
        tolerance_ns: i64,
        /// First and last time of the estimate.
        estimate: (Timestamp, Timestamp),
        /// First and last time of the ground truth.
        truth: (Timestamp, Timestamp),
    },
    /// Too few poses to align.
    #[error(
        "an alignment needs at least {FEWEST_PAIRS} pairs of poses, but only {pairs} of the {estimate_poses} estimated poses lie within {} ms of one of the {truth_poses} true ones",
        *tolerance_ns as f64 * 1e-6
    )]
    TooFewPairs {
        /// Pairs found.
        pairs: usize,
        /// Poses of the estimate.
        estimate_poses: usize,
        /// Poses of the ground truth.
        truth_poses: usize,
        /// Largest distance in time allowed, in nanoseconds.
        tolerance_ns: i64,
    },
}

/// Compares an estimated trajectory with the true one, whose worlds may differ by a rigid motion; scale is not aligned.
///
/// # Errors
/// An empty trajectory, a pose that is not finite, or fewer than three pairs of poses within `tolerance_ns`
/// nanoseconds of each other.
pub fn evaluate(estimate: &Trajectory, truth: &Trajectory, tolerance_ns: i64) -> Result<Evaluation, EvaluationError> {
    let estimate_range = check(estimate, "estimate")?;
    let truth_range = check(truth, "ground truth")?;
    let pairs = associate(estimate, truth, tolerance_ns);
    if pairs.is_empty() {
        return Err(EvaluationError::NoAssociation { tolerance_ns, estimate: estimate_range, truth: truth_range });
    }
    let (estimate_poses, truth_poses) = (estimate.len(), truth.len());
    let too_few = || EvaluationError::TooFewPairs { pairs: pairs.len(), estimate_poses, truth_poses, tolerance_ns };
    if pairs.len() < FEWEST_PAIRS {
        return Err(too_few());
    }

    let positions: Vec<(DVec3, DVec3)> =
        pairs.iter().map(|(e, t)| (e.world_from_camera.translation, t.world_from_camera.translation)).collect();
    let truth_from_estimate = align(&positions);
    let ate = positions.iter().map(|(e, t)| truth_from_estimate.transform_point(*e).distance(*t)).collect();

    let motion_errors: Vec<Se3> = pairs
        .windows(2)
        .map(|w| {
            let motion = |a: StampedPose, b: StampedPose| a.world_from_camera.inverse() * b.world_from_camera;
            motion(w[0].1, w[1].1).inverse() * motion(w[0].0, w[1].0)
        })
        .collect();
    let rpe_translation = motion_errors.iter().map(|e| e.translation.length()).collect();
    let rpe_rotation = motion_errors.iter().map(Se3::angle).collect();

    Ok(Evaluation {
        pairs: pairs.len(),
        estimate_poses,
        truth_poses,
        path_length_m: positions.windows(2).map(|w| w[0].1.distance(w[1].1)).sum(),
        ate: ErrorStatistics::new(ate).ok_or_else(too_few)?,
        rpe_translation: ErrorStatistics::new(rpe_translation).ok_or_else(too_few)?,
        rpe_rotation: ErrorStatistics::new(rpe_rotation).ok_or_else(too_few)?,
        truth_from_estimate,
    })
}

/// First and last time of a trajectory that has poses, all of them with numbers that can be squared and summed.
fn check(trajectory: &Trajectory, name: &'static str) -> Result<(Timestamp, Timestamp), EvaluationError> {
    const FARTHEST_M: f64 = 1e100;
    let poses = trajectory.poses();
    let (Some(first), Some(last)) = (poses.first(), poses.last()) else {
        return Err(EvaluationError::Empty { trajectory: name });
    };
    let usable = |p: &StampedPose| {
        p.world_from_camera.is_finite() && p.world_from_camera.translation.abs().max_element() < FARTHEST_M
    };
    match poses.iter().find(|p| !usable(p)) {
        Some(bad) => Err(EvaluationError::NotFinite { trajectory: name, timestamp: bad.timestamp }),
        None => Ok((first.timestamp, last.timestamp)),
    }
}

/// The rigid motion that takes the first point of each pair nearest to the second, by least squares: Horn 1987,
/// *Closed-form solution of absolute orientation using unit quaternions*, section 4. It has the optimum of Umeyama
/// 1991 without scale, and never meets a reflection.
///
/// Where several rotations do equally well (points on a line, or all in one place) it is the one nearest to the
/// identity.
fn align(pairs: &[(DVec3, DVec3)]) -> Se3 {
    let n = pairs.len() as f64;
    let mean = |point: fn(&(DVec3, DVec3)) -> DVec3| pairs.iter().map(point).sum::<DVec3>() / n;
    let (from_mean, to_mean) = (mean(|p| p.0), mean(|p| p.1));

    // s[a][b] sums component a of the first points times component b of the second ones.
    let mut s = [DVec3::ZERO; 3];
    for (from, to) in pairs {
        let (from, to) = (*from - from_mean, *to - to_mean);
        for (row, component) in s.iter_mut().zip(from.to_array()) {
            *row += component * to;
        }
    }
    let [xx, xy, xz] = s[0].to_array();
    let [yx, yy, yz] = s[1].to_array();
    let [zx, zy, zz] = s[2].to_array();
    // The quaternion (w, x, y, z) of the best rotation maximises qᵀ N q.
    #[rustfmt::skip]
    let eigen = Matrix4::new(
        xx + yy + zz, yz - zy,      zx - xz,       xy - yx,
        yz - zy,      xx - yy - zz, xy + yx,       zx + xz,
        zx - xz,      xy + yx,      -xx + yy - zz, yz + zy,
        xy - yx,      zx + xz,      yz + zy,       -xx - yy + zz,
    )
    .symmetric_eigen();

    // The identity's quaternion projected to the space of all optimal ones. The slack is what rounding does to equal
    // eigenvalues; two that differ by so little are optima that differ by less than the positions' last digits.
    let slack = 1e-12 * eigen.eigenvalues.amax();
    let best = eigen.eigenvalues.max();
    let mut quaternion = nalgebra::Vector4::zeros();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value >= best - slack {
            quaternion += vector[0] * vector;
        }
    }
    if quaternion.norm() < 1e-9 {
        // Half a turn: the identity is equally far from all of them.
        quaternion = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    }
    let [w, x, y, z] = quaternion.normalize().into();
    let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
    Se3 { rotation, translation: to_mean - rotation * from_mean }
}

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} of {} estimated poses have ground truth, over a path of {:.3} m",
            self.pairs, self.estimate_poses, self.path_length_m
        )?;
        let columns = ["rmse", "mean", "median", "std", "min", "max"];
        write!(f, "{:20}", "")?;
        for column in columns {
            write!(f, "{column:>10}")?;
        }
        let rows = [
            ("ATE (mm)", self.ate, 1e3),
            ("RPE (mm/frame)", self.rpe_translation, 1e3),
            ("RPE (degrees/frame)", self.rpe_rotation, 1f64.to_degrees()),
        ];
        for (name, e, unit) in rows {
            write!(f, "\n{name:20}")?;
            for value in [e.rmse, e.mean, e.median, e.std, e.min, e.max] {
                write!(f, "{:>10.3}", value * unit)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Poses 1/30 s apart.
    fn trajectory(poses: impl IntoIterator<Item = Se3>) -> Trajectory {
        let stamped =
            |(i, world_from_camera): (i64, _)| StampedPose { timestamp: Timestamp(i * 33_333_333), world_from_camera };
        (0..).zip(poses).map(stamped).collect()
    }

    /// A walk that bends in all directions.
    fn winding(frames: u32) -> impl Iterator<Item = Se3> {
        (0..frames).map(|i| {
            let t = 0.05 * f64::from(i);
            Se3::exp([t.sin(), 0.5 * (1.7 * t).cos(), 0.3 * t, 0.2 * t, 0.1 * (2.0 * t).sin(), -0.3])
        })
    }

    fn evaluate_poses(
        estimate: impl IntoIterator<Item = Se3>,
        truth: impl IntoIterator<Item = Se3>,
    ) -> Result<Evaluation, EvaluationError> {
        evaluate(&trajectory(estimate), &trajectory(truth), DEFAULT_TOLERANCE_NS)
    }

    #[test]
    fn statistics_of_known_numbers() {
        let even = ErrorStatistics::new(vec![4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((even.min, even.median, even.mean, even.max), (1.0, 2.5, 2.5, 4.0));
        assert!((even.rmse - 7.5f64.sqrt()).abs() < 1e-15 && (even.std - 1.25f64.sqrt()).abs() < 1e-15);
        assert_eq!(ErrorStatistics::new(vec![9.0, 1.0, 2.0]).unwrap().median, 2.0);
        assert_eq!(ErrorStatistics::new(vec![]), None);
    }

    #[test]
    fn poses_are_paired_with_the_nearest_in_time_and_used_once() {
        let at = |ns| StampedPose { timestamp: Timestamp(ns), world_from_camera: Se3::IDENTITY };
        let estimate: Trajectory = [0, 100, 104, 107, 200, 290].map(at).into_iter().collect();
        let truth: Trajectory = [1, 50, 106, 180, 310].map(at).into_iter().collect();
        let paired = |tolerance| -> Vec<(i64, i64)> {
            associate(&estimate, &truth, tolerance).iter().map(|(e, t)| (e.timestamp.0, t.timestamp.0)).collect()
        };
        assert_eq!(paired(20), [(0, 1), (107, 106), (200, 180), (290, 310)]);
        assert_eq!(paired(19), [(0, 1), (107, 106)]);
        assert_eq!(paired(0), []);
        assert_eq!(paired(-1), []);
    }

    proptest! {
        #[test]
        fn a_moved_copy_has_no_error(
            v in prop::array::uniform3(-100.0..100.0f64),
            w in prop::array::uniform3(-1.8..1.8f64),
        ) {
            let truth_from_estimate = Se3::exp([v[0], v[1], v[2], w[0], w[1], w[2]]);
            let e = evaluate_poses(winding(80).map(|p| truth_from_estimate.inverse() * p), winding(80)).unwrap();
            prop_assert!(e.ate.max < 1e-11 && e.rpe_translation.max < 1e-11 && e.rpe_rotation.max < 1e-11, "{e:?}");
            prop_assert!((e.truth_from_estimate * truth_from_estimate.inverse()).angle() < 1e-11);
        }

        #[test]
        fn no_other_alignment_does_better(
            v in prop::array::uniform3(-0.01..0.01f64),
            w in prop::array::uniform3(-0.01..0.01f64),
            noise in prop::collection::vec(prop::array::uniform3(-0.5..0.5f64), 40),
        ) {
            let pairs: Vec<(DVec3, DVec3)> =
                winding(40).zip(&noise).map(|(p, n)| (p.translation + DVec3::from(*n), p.translation)).collect();
            let cost = |m: Se3| pairs.iter().map(|(e, t)| m.transform_point(*e).distance_squared(*t)).sum::<f64>();
            let aligned = align(&pairs);
            prop_assert!(cost(aligned) <= cost(Se3::exp([v[0], v[1], v[2], w[0], w[1], w[2]]) * aligned) + 1e-12);
        }
    }

    #[test]
    fn errors_that_alignment_cannot_hide_are_measured_exactly() {
        // Corners of a cube, each estimated 10 % too far out: the distances are 0.1 √3, and no motion lessens them.
        let corner = |i: i32| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 2.0 - DVec3::ONE;
        let at = |position| Se3::new(DQuat::IDENTITY, position);
        let e = evaluate_poses((0..8).map(|i| at(1.1 * corner(i))), (0..8).map(|i| at(corner(i)))).unwrap();
        let expected = 0.1 * 3f64.sqrt();
        for value in [e.ate.rmse, e.ate.mean, e.ate.median, e.ate.min, e.ate.max] {
            assert!((value - expected).abs() < 1e-14, "{value}");
        }
        assert!(e.ate.std < 1e-14);
        // Along the cube's edges the motion is wrong by 0.2, along a face's diagonal by 0.2 √2, once by 0.2 √3.
        assert!((e.rpe_translation.min - 0.2).abs() < 1e-14 && e.rpe_rotation.max == 0.0);
        assert!((e.rpe_translation.max - 0.2 * 3f64.sqrt()).abs() < 1e-14);
    }

    #[test]
    fn a_mirrored_trajectory_is_not_reflected_into_place() {
        let mirror = |p: Se3| Se3 { translation: p.translation * DVec3::new(1.0, 1.0, -1.0), ..p };
        let e = evaluate_poses(winding(80).map(mirror), winding(80)).unwrap();
        assert!(e.ate.rmse > 0.01, "{e}");
        assert!((e.truth_from_estimate.rotation.length() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_constant_drift_is_the_relative_error_of_each_frame() {
        let drift = Se3::exp([0.003, -0.004, 0.0, 0.0, 0.0, 0.002]);
        let step = Se3::exp([0.02, 0.01, 0.03, 0.01, -0.02, 0.005]);
        let walk = |step: Se3| std::iter::successors(Some(Se3::IDENTITY), move |p| Some(*p * step)).take(50);
        let e = evaluate_poses(walk(step * drift), walk(step)).unwrap();
        assert!((e.rpe_translation.mean - drift.translation.length()).abs() < 1e-13, "{e}");
        assert!(e.rpe_translation.std < 1e-13 && e.rpe_rotation.std < 1e-13);
        assert!((e.rpe_rotation.median - 0.002).abs() < 1e-13);
        assert!((e.path_length_m - 49.0 * step.translation.length()).abs() < 1e-12);
        assert!(e.ate.rmse > 0.0);
    }

    #[test]
    fn the_relative_error_does_not_depend_on_the_worlds() {
        // A camera that turns on the spot by 0.01 rad a frame, estimated at 0.012.
        let turn = |rate: f64| (0..60).map(move |i| Se3::exp([0.0, 0.0, 0.0, 0.0, rate * f64::from(i), 0.0]));
        let elsewhere = Se3::exp([5.0, -2.0, 1.0, 1.0, 2.0, -1.0]);
        let e = evaluate_poses(turn(0.012).map(|p| elsewhere * p), turn(0.01)).unwrap();
        assert!((e.rpe_rotation.rmse - 0.002).abs() < 1e-12 && e.rpe_translation.max < 1e-12, "{e}");
        assert!(e.ate.max < 1e-12);
    }

    #[test]
    fn straight_and_resting_trajectories_align_with_the_smallest_rotation() {
        let line = |direction: DVec3| (0..30).map(move |i| Se3::new(DQuat::IDENTITY, direction * f64::from(i)));
        let along = DVec3::new(0.1, 0.2, -0.05);
        let same = evaluate_poses(line(along), line(along)).unwrap();
        assert!(same.ate.max < 1e-13 && same.truth_from_estimate.angle() < 1e-9, "{same:?}");

        let across = evaluate_poses(line(DVec3::X), line(DVec3::Y)).unwrap();
        assert!(across.ate.max < 1e-12 && (across.truth_from_estimate.angle() - 90f64.to_radians()).abs() < 1e-9);
        let back = evaluate_poses(line(along), line(-along)).unwrap();
        assert!(back.ate.max < 1e-12 && (back.truth_from_estimate.angle() - 180f64.to_radians()).abs() < 1e-9);

        let resting = evaluate_poses(line(DVec3::ZERO), line(DVec3::ZERO)).unwrap();
        assert_eq!(resting.truth_from_estimate, Se3::IDENTITY);
        assert_eq!((resting.ate.max, resting.path_length_m), (0.0, 0.0));
    }

    #[test]
    fn what_cannot_be_compared_is_refused_with_the_reason() {
        let of = |n| trajectory(winding(n));
        let late: Trajectory = of(5)
            .poses()
            .iter()
            .map(|p| StampedPose { timestamp: Timestamp(p.timestamp.0 + 1_000_000_000), ..*p })
            .collect();
        let error = evaluate(&of(5), &late, DEFAULT_TOLERANCE_NS).unwrap_err();
        assert_eq!(
            error.to_string(),
            "no estimated pose lies within 20 ms of a true one: the estimate runs from 0.000000000 s to 0.133333332 s, \
             the ground truth from 1.000000000 s to 1.133333332 s"
        );
        let error = evaluate(&of(9), &of(2), DEFAULT_TOLERANCE_NS).unwrap_err();
        assert_eq!(
            error,
            EvaluationError::TooFewPairs { pairs: 2, estimate_poses: 9, truth_poses: 2, tolerance_ns: 20_000_000 }
        );
        assert_eq!(evaluate(&Trajectory::default(), &of(3), 0), Err(EvaluationError::Empty { trajectory: "estimate" }));
        for bad in [f64::NAN, f64::INFINITY, 1e200] {
            let bad = Se3 { translation: DVec3::new(0.0, bad, 0.0), ..Se3::IDENTITY };
            assert_eq!(
                evaluate_poses(winding(3), [Se3::IDENTITY, bad, Se3::IDENTITY]),
                Err(EvaluationError::NotFinite { trajectory: "ground truth", timestamp: Timestamp(33_333_333) })
            );
        }
    }

    #[test]
    fn the_table_is_in_millimetres_and_degrees() {
        let e = ErrorStatistics { rmse: 0.0125, mean: 0.01, median: 0.009, std: 0.001, min: 0.0, max: 0.02 };
        let evaluation = Evaluation {
            pairs: 90,
            estimate_poses: 100,
            truth_poses: 3000,
            path_length_m: 1.5,
            ate: e,
            rpe_translation: e,
            rpe_rotation: e,
            truth_from_estimate: Se3::IDENTITY,
        };
        let lines: Vec<String> = evaluation.to_string().lines().map(String::from).collect();
        assert_eq!(lines[0], "90 of 100 estimated poses have ground truth, over a path of 1.500 m");
        assert_eq!(lines[2].split_whitespace().collect::<Vec<_>>()[..4], ["ATE", "(mm)", "12.500", "10.000"]);
        assert!(lines[4].starts_with("RPE (degrees/frame)      0.716"), "{}", lines[4]);
        let toml = toml::to_string(&evaluation).unwrap();
        assert_eq!(toml::from_str::<Evaluation>(&toml).unwrap(), evaluation);
    }
}
