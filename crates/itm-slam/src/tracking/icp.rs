//! Depth tracking by point-to-plane ICP from coarse to fine (Newcombe et al. 2011, section 3.5; the report, section
//! 3.1.1), with damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963).

use itm_core::{IcpSettings, Se3};
use nalgebra::{Matrix6, Vector6};

use super::{NormalEquations, Objective, Tracked, Verdict};

/// Which parts of the pose a level estimates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Rotation,
    Translation,
    Both,
    Nothing,
}

impl Part {
    fn from_letter(letter: char) -> Self {
        match letter {
            'r' => Self::Rotation,
            't' => Self::Translation,
            'n' => Self::Nothing,
            _ => Self::Both,
        }
    }

    /// Whether an unknown (translation 0 to 2, rotation 3 to 5) is estimated.
    fn includes(self, unknown: usize) -> bool {
        match self {
            Self::Rotation => unknown >= 3,
            Self::Translation => unknown < 3,
            Self::Both => true,
            Self::Nothing => false,
        }
    }
}

/// Finds the pose at which the objective is least, starting from `initial`.
///
/// A level ends when its steps are used up, a step is shorter than `min_step`, or no damped step lowers the mean square
/// distance.
///
/// # Errors
/// Where the device was lost. That tracking failed is no error but a verdict.
pub fn track(objective: &mut dyn Objective, initial: &Se3, settings: &IcpSettings) -> Result<Tracked, itm_gpu::Error> {
    let letters: Vec<Part> = settings.levels.chars().map(Part::from_letter).collect();
    let mut pose = *initial;
    let mut evaluations = vec![0; letters.len()];
    let mut last = None;
    for (i, part) in letters.iter().enumerate() {
        if *part == Part::Nothing {
            continue;
        }
        // From 0 at the coarsest level to 1 at the finest.
        let fine = if letters.len() > 1 { i as f32 / (letters.len() - 1) as f32 } else { 1.0 };
        let between = |coarse: f32, finest: f32| coarse + fine * (finest - coarse);
        let level = letters.len() - 1 - i;
        let max_distance = between(settings.max_distance_coarse_m, settings.max_distance_fine_m);
        let steps = between(settings.max_steps_coarse as f32, settings.max_steps_fine as f32).round() as u32;

        let mut equations = objective.evaluate(&pose, level, max_distance)?;
        evaluations[i] += 1;
        let mut damping = 0.0;
        for _ in 0..steps {
            let Some(step) = solve(&equations, *part, damping) else { break };
            let candidate = moved(&pose, objective.pivot(), &step);
            if step.norm() < settings.min_step {
                pose = candidate;
                break;
            }
            let there = objective.evaluate(&candidate, level, max_distance)?;
            evaluations[i] += 1;
            if mean_square(&there) <= mean_square(&equations) {
                pose = candidate;
                equations = there;
                damping *= 0.1;
            } else {
                damping = f64::max(damping * 10.0, 1e-3);
            }
        }
        last = Some(equations);
    }
    Ok(judge(initial, pose, last, evaluations, settings))
}

/// Mean square distance; infinite without pairs, so that no step ends there.
fn mean_square(equations: &NormalEquations) -> f64 {
    if equations.count == 0 { f64::INFINITY } else { equations.squares / f64::from(equations.count) }
}

/// The damped Gauss-Newton step in the unknowns that are estimated, zero in the others; `None` where the equations do not
/// determine it.
fn solve(equations: &NormalEquations, part: Part, damping: f64) -> Option<Vector6<f64>> {
    let mut hessian = Matrix6::from_fn(|r, c| equations.hessian[r][c]);
    let mut gradient = Vector6::from_iterator(equations.gradient);
    for i in 0..6 {
        hessian[(i, i)] *= 1.0 + damping;
        if !part.includes(i) {
            hessian.row_mut(i).fill(0.0);
            hessian.column_mut(i).fill(0.0);
            hessian[(i, i)] = 1.0;
            gradient[i] = 0.0;
        }
    }
    let step = -hessian.cholesky()?.solve(&gradient);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// The pose after a step about a pivot: a point p moves to `pivot + exp(step) (p - pivot)`.
fn moved(pose: &Se3, pivot: glam::DVec3, step: &Vector6<f64>) -> Se3 {
    let to_pivot = Se3::new(glam::DQuat::IDENTITY, pivot);
    let mut twist = [0.0; 6];
    twist.copy_from_slice(step.as_slice());
    to_pivot * Se3::exp(twist) * to_pivot.inverse() * *pose
}

fn judge(
    initial: &Se3,
    pose: Se3,
    last: Option<NormalEquations>,
    evaluations: Vec<u32>,
    settings: &IcpSettings,
) -> Tracked {
    let (inliers, valid, mean) = last.map_or((0, 0, f64::INFINITY), |e| (e.count, e.valid, mean_square(&e)));
    let share = if valid == 0 { 0.0 } else { f64::from(inliers) / f64::from(valid) };
    let reason = if valid == 0 {
        Some("no pixel has a depth within the view's range".to_string())
    } else if inliers < settings.min_inliers {
        Some(format!("{inliers} points agree with the map, at least {} are needed", settings.min_inliers))
    } else if share < settings.min_inlier_share {
        Some(format!(
            "{:.0} % of the points agree with the map, at least {:.0} % are needed",
            100.0 * share,
            100.0 * settings.min_inlier_share
        ))
    } else if !pose.is_finite() {
        Some("the pose is not finite".to_string())
    } else {
        None
    };
    Tracked {
        world_from_camera: if reason.is_some() { *initial } else { pose },
        verdict: reason.map_or(Verdict::Good, |reason| Verdict::Lost { reason }),
        inliers,
        inlier_share: share,
        rms_m: mean.sqrt(),
        evaluations,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// Points on three orthogonal planes, each with its normal: the residuals are exact, so the truth is reached.
    struct Corner {
        points: Vec<(DVec3, DVec3)>,
        world_from_truth: Se3,
        blind: bool,
    }

    impl Corner {
        fn new(world_from_truth: Se3) -> Self {
            let mut points = Vec::new();
            for i in 0..20 {
                for j in 0..20 {
                    let (a, b) = (0.05 + f64::from(i) * 0.05, 0.05 + f64::from(j) * 0.05);
                    points.push((DVec3::new(a, b, 0.0), DVec3::Z));
                    points.push((DVec3::new(a, 0.0, b), DVec3::Y));
                    points.push((DVec3::new(0.0, a, b), DVec3::X));
                }
            }
            Self { points, world_from_truth, blind: false }
        }
    }

    impl Objective for Corner {
        fn levels(&self) -> usize {
            2
        }

        fn pivot(&self) -> DVec3 {
            DVec3::new(0.3, -0.2, 0.7)
        }

        fn evaluate(
            &mut self,
            world_from_camera: &Se3,
            _level: usize,
            _max_distance_m: f32,
        ) -> Result<NormalEquations, itm_gpu::Error> {
            let mut e = NormalEquations {
                hessian: [[0.0; 6]; 6],
                gradient: [0.0; 6],
                squares: 0.0,
                count: 0,
                valid: self.points.len() as u32,
            };
            if self.blind {
                return Ok(e);
            }
            for (point, normal) in &self.points {
                let seen = self.world_from_truth.inverse().transform_point(*point);
                let p = world_from_camera.transform_point(seen);
                let turn = (p - self.pivot()).cross(*normal);
                let j = [normal.x, normal.y, normal.z, turn.x, turn.y, turn.z];
                let r = (p - *point).dot(*normal);
                for a in 0..6 {
                    e.gradient[a] += j[a] * r;
                    for b in 0..6 {
                        e.hessian[a][b] += j[a] * j[b];
                    }
                }
                e.squares += r * r;
                e.count += 1;
            }
            Ok(e)
        }
    }

    fn settings(levels: &str) -> IcpSettings {
        IcpSettings {
            levels: levels.into(),
            max_steps_coarse: 20,
            max_steps_fine: 20,
            min_step: 1e-10,
            ..Default::default()
        }
    }

    #[test]
    fn the_true_pose_is_found() {
        let truth = Se3::exp([0.1, -0.05, 0.2, 0.1, 0.2, -0.15]);
        let tracked = track(&mut Corner::new(truth), &Se3::IDENTITY, &settings("bb")).unwrap();
        assert_eq!(tracked.verdict, Verdict::Good);
        let error = (truth.inverse() * tracked.world_from_camera).log();
        assert!(error.iter().all(|v| v.abs() < 1e-8), "{error:?}");
    }

    #[test]
    fn a_level_moves_only_what_its_letter_says() {
        let truth = Se3::exp([0.02, -0.01, 0.03, 0.02, 0.01, -0.02]);
        let pivot = Corner::new(truth).pivot();
        let turned = track(&mut Corner::new(truth), &Se3::IDENTITY, &settings("r")).unwrap().world_from_camera;
        assert!(turned.angle() > 1e-3);
        assert!(turned.transform_point(pivot).abs_diff_eq(pivot, 1e-12), "a rotation leaves the pivot");
        let shifted = track(&mut Corner::new(truth), &Se3::IDENTITY, &settings("t")).unwrap().world_from_camera;
        assert!(shifted.translation.length() > 1e-3 && shifted.angle() < 1e-12);
        assert_eq!(
            track(&mut Corner::new(truth), &Se3::IDENTITY, &settings("nn")).unwrap().world_from_camera,
            Se3::IDENTITY
        );
    }

    #[test]
    fn without_pairs_tracking_is_lost_and_the_pose_stays() {
        let mut corner = Corner::new(Se3::IDENTITY);
        corner.blind = true;
        let initial = Se3::exp([0.1, 0.2, 0.3, 0.0, 0.1, 0.0]);
        let tracked = track(&mut corner, &initial, &settings("rb")).unwrap();
        assert!(matches!(tracked.verdict, Verdict::Lost { .. }));
        assert_eq!(tracked.world_from_camera, initial);
    }

    #[test]
    fn a_single_plane_gives_no_pose_that_is_not_finite() {
        let mut corner = Corner::new(Se3::exp([0.0, 0.0, 0.01, 0.0, 0.0, 0.0]));
        corner.points.retain(|(_, n)| *n == DVec3::Z);
        let tracked = track(&mut corner, &Se3::IDENTITY, &settings("rb")).unwrap();
        assert!(tracked.world_from_camera.is_finite());
    }
}
