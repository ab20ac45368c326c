//! One optimiser for every tracker: Levenberg-Marquardt steps on reweighted least squares, from coarse to fine (Levenberg
//! 1944, Marquardt 1963; the report, section 3.1).

use glam::DVec3;
use itm_core::Se3;
use nalgebra::Vector6;

use super::{Evaluation, Guess, LevelPlan, Noise, NormalEquations, Objective, Plan, Request};

/// What an optimisation found.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Where it ended.
    pub guess: Guess,
    /// Which of the starts it came from.
    pub start: usize,
    /// Evaluations of the objective at each level, from the coarsest, levels that estimate nothing included.
    pub evaluations: Vec<u32>,
    /// The sums at the end, of the finest level that was used; nothing where there was none.
    pub last: Evaluation,
    /// Their equations.
    pub equations: Option<NormalEquations>,
    /// Directions of motion that were held at the finest level.
    pub held: usize,
}

/// Finds the pose at which the objective is least, starting from the best of several guesses: the coarsest level is carried
/// out from each. Among equals the first one wins.
///
/// A level ends when its steps are used up, a step is shorter than the plan's shortest, or no damped step lowers the cost.
///
/// # Errors
/// Where the device was lost. That nothing was found is no error.
pub fn optimise(
    objective: &mut dyn Objective,
    starts: &[Guess],
    plan: &Plan,
    noise: &Noise,
) -> Result<Outcome, itm_gpu::Error> {
    let mut outcome = Outcome {
        guess: starts.first().copied().unwrap_or_default(),
        start: 0,
        evaluations: vec![0; plan.letters],
        last: Evaluation::default(),
        equations: None,
        held: 0,
    };
    for (place, level) in plan.levels.iter().enumerate() {
        let index = plan.letters - 1 - level.request.level;
        let found = if place == 0 {
            let mut best: Option<LevelEnd> = None;
            for (start, end) in descend(objective, starts, level, plan, noise)?.into_iter().enumerate() {
                outcome.evaluations[index] += end.evaluations;
                // Another start must be better by more than rounding, so that ties are held at the first one.
                if best.as_ref().is_none_or(|b| end.equations.cost_of_all < 0.98 * b.equations.cost_of_all) {
                    outcome.start = start;
                    best = Some(end);
                }
            }
            best
        } else {
            let end = descend(objective, &[outcome.guess], level, plan, noise)?.pop();
            outcome.evaluations[index] += end.as_ref().map_or(0, |end| end.evaluations);
            end
        };
        let Some(end) = found else { continue };
        outcome.guess = end.guess;
        outcome.held = end.held;
        outcome.last = end.evaluation;
        outcome.equations = Some(end.equations);
    }
    Ok(outcome)
}

/// Finds the pose at which the objective is least from each of several guesses, as [`optimise`] does from one: together, so that
/// it waits as often as for the one that takes longest. In the guesses' order.
///
/// # Errors
/// As [`optimise`].
pub(crate) fn optimise_each(
    objective: &mut dyn Objective,
    starts: &[Guess],
    plan: &Plan,
    noise: &Noise,
) -> Result<Vec<(Guess, Option<NormalEquations>)>, itm_gpu::Error> {
    let mut found: Vec<_> = starts.iter().map(|guess| (*guess, None)).collect();
    for level in &plan.levels {
        let guesses: Vec<Guess> = found.iter().map(|(guess, _)| *guess).collect();
        let ends = descend(objective, &guesses, level, plan, noise)?;
        found = ends.into_iter().map(|end| (end.guess, Some(end.equations))).collect();
    }
    Ok(found)
}

/// Where a level ended.
struct LevelEnd {
    guess: Guess,
    evaluation: Evaluation,
    equations: NormalEquations,
    evaluations: u32,
    held: usize,
}

/// One level's way down from one guess.
struct Descent<'a> {
    level: &'a LevelPlan,
    plan: &'a Plan,
    noise: &'a Noise,
    request: Request,
    pivot: DVec3,
    colour_weight: f64,
    end: LevelEnd,
    damping: f64,
    steps: u32,
    /// What is to be evaluated next.
    candidate: Option<Guess>,
}

impl<'a> Descent<'a> {
    fn new(
        (level, plan, noise): (&'a LevelPlan, &'a Plan, &'a Noise),
        request: Request,
        pivot: DVec3,
        guess: Guess,
        evaluation: Evaluation,
    ) -> Self {
        let colour_weight = NormalEquations::colour_weight(&evaluation, &request, plan, noise);
        let equations = NormalEquations::new(&evaluation, &request, plan, noise, colour_weight);
        let end = LevelEnd { guess, evaluation, equations, evaluations: 1, held: 0 };
        let mut descent =
            Self { level, plan, noise, request, pivot, colour_weight, end, damping: 0.0, steps: 0, candidate: None };
        descent.propose();
        descent
    }

    /// Finds the next candidate, or none at the end.
    fn propose(&mut self) {
        self.candidate = None;
        let LevelEnd { guess, evaluation, equations, held, .. } = &mut self.end;
        if self.steps == self.level.max_steps || pairs(evaluation) < self.plan.min_pairs {
            return;
        }
        self.steps += 1;
        let Some((step, held_now)) = equations.step(self.level.part, self.damping, self.plan.min_information) else {
            return;
        };
        *held = held_now;
        let candidate = Guess {
            world_from_camera: moved(&guess.world_from_camera, self.pivot, &step),
            exposure: equations.exposures(guess, &step),
        };
        if step.norm() < self.plan.min_step {
            *guess = candidate;
        } else {
            self.candidate = Some(candidate);
        }
    }

    /// Goes to the candidate if it is better there, and on.
    fn take(&mut self, evaluation: Evaluation) {
        let Some(candidate) = self.candidate.take() else { return };
        let Self { request, plan, noise, colour_weight, end, .. } = self;
        let equations = NormalEquations::new(&evaluation, request, plan, noise, *colour_weight);
        end.evaluations += 1;
        if equations.cost <= end.equations.cost {
            let small = end.equations.cost - equations.cost < plan.min_decrease * end.equations.cost;
            (end.guess, end.evaluation, end.equations) = (candidate, evaluation, equations);
            self.damping *= 0.1;
            if small {
                return;
            }
        } else {
            self.damping = f64::max(self.damping * 10.0, 1e-2);
            if self.damping > 1e3 {
                return;
            }
        }
        self.propose();
    }
}

/// Carries a level out from each of several guesses.
fn descend(
    objective: &mut dyn Objective,
    starts: &[Guess],
    level: &LevelPlan,
    plan: &Plan,
    noise: &Noise,
) -> Result<Vec<LevelEnd>, itm_gpu::Error> {
    let mut request = level.request;
    for (term, sigma) in request.colour.iter_mut().zip(noise.colour) {
        // Before the images are aligned, differences are larger than the noise.
        if let Some(term) = term.as_mut().filter(|_| level.finest) {
            term.cutoff = term.cutoff.min((plan.tukey_cutoff * sigma) as f32);
        }
    }
    let pivot = objective.pivot();
    let evaluations = objective.evaluate_all(starts, &request)?;
    let of = (level, plan, noise);
    let mut descents: Vec<_> = starts
        .iter()
        .zip(evaluations)
        .map(|(guess, evaluation)| Descent::new(of, request, pivot, *guess, evaluation))
        .collect();
    loop {
        let (going, candidates): (Vec<_>, Vec<Guess>) =
            descents.iter_mut().filter_map(|descent| descent.candidate.map(|candidate| (descent, candidate))).unzip();
        if going.is_empty() {
            break;
        }
        for (descent, evaluation) in going.into_iter().zip(objective.evaluate_all(&candidates, &request)?) {
            descent.take(evaluation);
        }
    }
    for Descent { end: LevelEnd { evaluations, held, equations, evaluation, guess }, damping, .. } in &descents {
        tracing::trace!(
            level = level.request.level,
            evaluations,
            held,
            damping,
            cost = equations.cost,
            pairs = pairs(evaluation),
            information = ?equations.information(),
            ?noise,
            exposure = ?guess.exposure,
            "a level ended"
        );
    }
    Ok(descents.into_iter().map(|descent| descent.end).collect())
}

fn pairs(evaluation: &Evaluation) -> u32 {
    evaluation.depth.map_or(0, |d| d.count) + evaluation.colour.iter().flatten().map(|c| c.count).sum::<u32>()
}

/// The pose after a step about a pivot: a point p moves to `pivot + exp(step) (p - pivot)`.
fn moved(pose: &Se3, pivot: DVec3, step: &Vector6<f64>) -> Se3 {
    let to_pivot = Se3::new(glam::DQuat::IDENTITY, pivot);
    let mut twist = [0.0; 6];
    twist.copy_from_slice(step.as_slice());
    to_pivot * Se3::exp(twist) * to_pivot.inverse() * *pose
}

#[cfg(test)]
mod tests {
    use itm_core::{IcpSettings, Settings};
    use itm_gpu::{DepthSums, PhotometricSums};
    use nalgebra::SVector;

    use super::*;
    use crate::tracking::{Against, Exposure, Request};

    /// Points on three orthogonal planes, each with its normal, and what is measured there: the residuals are exact, so the
    /// truth is reached.
    #[derive(Clone)]
    struct Corner {
        points: Vec<(DVec3, DVec3)>,
        world_from_truth: Se3,
        blind: bool,
        /// How far measurements are off their planes, at most, in metres.
        noise_m: f64,
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
            Self { points, world_from_truth, blind: false, noise_m: 0.0 }
        }

        /// The plane z = 0 alone.
        fn plane() -> Self {
            let mut plane = Self::new(Se3::IDENTITY);
            plane.points.retain(|(_, normal)| *normal == DVec3::Z);
            plane
        }

        fn noisy(mut self, noise_m: f64) -> Self {
            self.noise_m = noise_m;
            self
        }
    }

    const PIVOT: DVec3 = DVec3::new(0.3, -0.2, 0.7);

    impl Objective for Corner {
        fn pivot(&self) -> DVec3 {
            PIVOT
        }

        fn evaluate(&mut self, guess: &Guess, request: &Request) -> Result<Evaluation, itm_gpu::Error> {
            let max_distance_m = f64::from(request.depth.expect("a depth term").max_distance_m);
            let mut e = DepthSums { valid: self.points.len() as u32, ..DepthSums::default() };
            for (i, (point, normal)) in self.points.iter().enumerate() {
                let seen = self.world_from_truth.inverse().transform_point(*point);
                let p = guess.world_from_camera.transform_point(seen);
                let r = (p - *point).dot(*normal) + self.noise_m * (12.9898 * i as f64).sin();
                if self.blind {
                    e.unseen += 1.0;
                    continue;
                }
                if r.abs() > max_distance_m {
                    e.apart += 1.0;
                    continue;
                }
                let turn = (p - PIVOT).cross(*normal);
                let j = [normal.x, normal.y, normal.z, turn.x, turn.y, turn.z];
                for a in 0..6 {
                    e.gradient[a] += j[a] * r;
                    for b in 0..6 {
                        e.hessian[a][b] += j[a] * j[b];
                    }
                }
                e.cost += 0.5 * r * r;
                e.squares += r * r;
                e.weights += 1.0;
                e.count += 1;
            }
            Ok(Evaluation { depth: Some(e), ..Evaluation::default() })
        }
    }

    fn plan(levels: &str) -> Plan {
        let icp = IcpSettings {
            max_steps_coarse: 20,
            max_steps_fine: 20,
            min_step: 1e-10,
            max_distance_coarse_m: 0.5,
            max_distance_fine_m: 0.5,
            ..IcpSettings::default()
        };
        Plan { min_information: None, ..Plan::icp(&Settings::default(), &icp, levels) }
    }

    fn found(objective: &mut dyn Objective, start: Se3, plan: &Plan) -> Outcome {
        optimise(objective, &[Guess::at(start)], plan, &Noise::default()).unwrap()
    }

    fn off(truth: &Se3, pose: &Se3) -> f64 {
        (truth.inverse() * *pose).log().iter().fold(0.0, |most, v| v.abs().max(most))
    }

    #[test]
    fn the_true_pose_is_found() {
        let truth = Se3::exp([0.1, -0.05, 0.2, 0.1, 0.2, -0.15]);
        let outcome = found(&mut Corner::new(truth), Se3::IDENTITY, &plan("bb"));
        assert!(off(&truth, &outcome.guess.world_from_camera) < 1e-8, "{outcome:?}");
        assert_eq!((outcome.start, outcome.held), (0, 0));
        // The coarser level is enough: the finer one looks where it is, and perhaps once more.
        assert!(outcome.evaluations[0] > 2 && (1..=2).contains(&outcome.evaluations[1]), "{:?}", outcome.evaluations);
        assert_eq!(outcome.last.depth.unwrap().count, 1200);
        assert!(outcome.equations.unwrap().cost < 1e-10);
    }

    #[test]
    fn a_level_moves_only_what_its_letter_says() {
        let truth = Se3::exp([0.02, -0.01, 0.03, 0.02, 0.01, -0.02]);
        let end = |levels| found(&mut Corner::new(truth), Se3::IDENTITY, &plan(levels));
        let turned = end("r").guess.world_from_camera;
        assert!(turned.angle() > 1e-3);
        assert!(turned.transform_point(PIVOT).abs_diff_eq(PIVOT, 1e-12), "a rotation leaves the pivot");
        let shifted = end("t").guess.world_from_camera;
        assert!(shifted.translation.length() > 1e-3 && shifted.angle() < 1e-12);
        let nothing = end("nn");
        assert_eq!(nothing.guess, Guess::at(Se3::IDENTITY));
        assert_eq!((nothing.evaluations, nothing.last, nothing.equations), (vec![0, 0], Evaluation::default(), None));
        let last_only = end("nb");
        assert!(last_only.evaluations[0] == 0 && last_only.evaluations[1] > 2);
        assert!(off(&truth, &last_only.guess.world_from_camera) < 1e-8);
    }

    #[test]
    fn without_pairs_the_pose_stays() {
        let start = Se3::exp([0.1, 0.2, 0.3, 0.0, 0.1, 0.0]);
        let blind = Corner { blind: true, ..Corner::new(Se3::IDENTITY) };
        // Too few of them are no better than none.
        let mut few = Corner::new(Se3::IDENTITY);
        few.points.truncate(99);
        for mut objective in [blind, few] {
            let outcome = found(&mut objective, start, &plan("rb"));
            assert_eq!(outcome.guess, Guess::at(start));
            assert_eq!(outcome.evaluations, [1, 1]);
        }
        let none = optimise(&mut Corner::new(start), &[], &plan("bb"), &Noise::default()).unwrap();
        assert!(none.guess.world_from_camera.is_finite());
    }

    #[test]
    fn a_single_plane_gives_no_pose_that_is_not_finite() {
        for noise_m in [0.0, 0.005] {
            let start = Se3::exp([0.0, 0.0, 0.01, 0.0, 0.0, 0.0]);
            let outcome = found(&mut Corner::plane().noisy(noise_m), start, &plan("rb"));
            assert!(outcome.guess.world_from_camera.is_finite());
        }
    }

    #[test]
    fn along_a_plane_the_start_is_held_and_across_it_the_pose_is_found() {
        let start = Se3::exp([0.02, -0.03, 0.01, 0.0, 0.0, 0.1]);
        let holding = Plan { min_information: Some(1e-3), ..plan("bb") };
        let outcome = found(&mut Corner::plane(), start, &holding);
        assert_eq!(outcome.held, 3, "two shifts and a turn are not determined");
        let pose = outcome.guess.world_from_camera;
        assert!(pose.translation.z.abs() < 1e-9, "{pose:?}");
        let left = pose.inverse() * start;
        // The directions come out of an eigenvalue decomposition.
        assert!(left.translation.truncate().length() < 1e-12 && left.angle() < 1e-12, "{left:?}");
    }

    #[test]
    fn noise_moves_a_pose_along_a_plane_unless_it_is_held() {
        // Normals that waver, as a map's do, seem to say where along the plane the camera is.
        let mut objective = Corner::plane().noisy(0.004);
        for (i, (_, normal)) in objective.points.iter_mut().enumerate() {
            let i = i as f64;
            *normal = (*normal + 0.02 * DVec3::new((78.233 * i).sin(), (37.719 * i).sin(), 0.0)).normalize();
        }
        let start = Se3::exp([0.02, -0.03, 0.01, 0.0, 0.0, 0.0]);
        let sideways = |min_information| {
            let outcome = found(&mut objective.clone(), start, &Plan { min_information, ..plan("bb") });
            let pose = outcome.guess.world_from_camera;
            assert!(pose.translation.z.abs() < 2e-3, "across the plane: {pose:?}");
            ((pose.translation - start.translation).truncate().length(), outcome.held)
        };
        let (free, held) = (sideways(None), sideways(Some(1e-3)));
        assert!(free.0 > 5e-3 && free.1 == 0, "{free:?}");
        // What is held is nearly, but not exactly, the motion along the plane.
        assert!(held.0 < 5e-4 && held.1 == 3, "{held:?}");
    }

    #[test]
    fn from_each_of_several_starts_the_same_is_found_as_from_it_alone() {
        let truth = Se3::exp([0.1, -0.05, 0.2, 0.1, 0.2, -0.15]);
        let mut corner = Corner::new(truth).noisy(0.003);
        // One that needs longer, one that is there at once, and one from which nothing is found.
        let starts = [[0.3, 0.1, -0.2, 0.0, 0.4, 0.0], truth.log(), [0.0; 6], [9.0, 9.0, 9.0, 0.0, 0.0, 0.0]];
        let starts = starts.map(|twist| Guess::at(Se3::exp(twist)));
        let each = optimise_each(&mut corner, &starts, &plan("bb"), &Noise::default()).unwrap();
        assert_eq!(each.len(), starts.len());
        for ((guess, equations), start) in each.into_iter().zip(starts) {
            let alone = found(&mut corner, start.world_from_camera, &plan("bb"));
            assert_eq!((guess, equations), (alone.guess, alone.equations));
        }
    }

    #[test]
    fn the_best_start_wins_and_the_first_among_equals() {
        let truth = Se3::exp([0.1, 0.0, 0.0, 0.0, 0.1, 0.0]);
        let best = |starts: &[Se3]| {
            let guesses: Vec<Guess> = starts.iter().map(|pose| Guess::at(*pose)).collect();
            // With noise, because at an exact fit costs are nothing but rounding.
            optimise(&mut Corner::new(truth).noisy(0.003), &guesses, &plan("bb"), &Noise::default()).unwrap()
        };
        // Too far away from every plane to find a pair.
        let far = Se3::exp([2.0, 2.0, 2.0, 0.0, 0.0, 0.0]);
        let (near, also_near) = (Se3::IDENTITY, Se3::exp([0.0, 0.05, 0.0, 0.0, 0.0, 0.1]));
        let alone = best(&[near]);
        for (starts, wins) in [(vec![far, near], 1), (vec![near, far], 0), (vec![far, far, near], 2)] {
            let outcome = best(&starts);
            assert_eq!(outcome.start, wins);
            assert_eq!(outcome.guess, alone.guess);
            let looks = (starts.len() - 1) as u32;
            assert_eq!(outcome.evaluations, [alone.evaluations[0] + looks, alone.evaluations[1]]);
        }
        for starts in [[near, also_near], [also_near, near], [far, far]] {
            assert_eq!(best(&starts).start, 0);
        }
        assert_eq!(best(&[far, far]).guess, Guess::at(far));
    }

    /// Points with colours that change linearly with the place, seen by a camera with another exposure.
    struct Coloured {
        exposure: Exposure,
    }

    impl Objective for Coloured {
        fn pivot(&self) -> DVec3 {
            PIVOT
        }

        fn evaluate(&mut self, guess: &Guess, request: &Request) -> Result<Evaluation, itm_gpu::Error> {
            let mut evaluation = Evaluation::default();
            for ((sums, term), expected) in evaluation.colour.iter_mut().zip(request.colour).zip(guess.exposure) {
                if term.is_none() {
                    continue;
                }
                let mut s = PhotometricSums::default();
                for i in 0..500 {
                    let wave = |a: f64| (a * f64::from(i)).sin();
                    let point = DVec3::new(wave(1.1), wave(2.3), wave(3.7));
                    let (along, value) = (DVec3::new(wave(4.1), wave(5.3), wave(6.7)), 0.5 + 0.4 * wave(7.9));
                    let moved = guess.world_from_camera.transform_point(point);
                    let r = expected.gain * value + expected.offset
                        - (self.exposure.gain * value + self.exposure.offset)
                        + along.dot(moved - point);
                    let turn = (moved - PIVOT).cross(along);
                    let j = [along.x, along.y, along.z, turn.x, turn.y, turn.z, value, 1.0];
                    let j = SVector::<f64, 8>::from(j);
                    for a in 0..8 {
                        s.gradient[a] += j[a] * r;
                        for b in 0..8 {
                            s.hessian[a][b] += j[a] * j[b];
                        }
                    }
                    s.cost += 0.5 * r * r;
                    s.squares += r * r;
                    s.weights += 1.0;
                    (s.count, s.valid) = (s.count + 1, s.valid + 1);
                }
                *sums = Some(s);
            }
            Ok(evaluation)
        }
    }

    #[test]
    fn pose_and_exposure_are_found_together() {
        let exposure = Exposure { gain: 1.3, offset: -0.07 };
        let start = Se3::exp([0.02, -0.01, 0.015, 0.02, 0.03, -0.01]);
        let rgb = Plan::rgb(&Settings::default(), &Settings::default().tracker.rgb);
        for estimate_exposure in [true, false] {
            let plan =
                Plan { estimate_exposure, min_information: None, min_step: 1e-10, min_decrease: 0.0, ..rgb.clone() };
            let guess = found(&mut Coloured { exposure }, start, &plan).guess;
            let [previous, map] = guess.exposure;
            assert_eq!(previous, Exposure::default(), "nothing was compared with the frame before");
            if estimate_exposure {
                assert!(off(&Se3::IDENTITY, &guess.world_from_camera) < 1e-8, "{guess:?}");
                assert!((map.gain - 1.3).abs() < 1e-8 && (map.offset + 0.07).abs() < 1e-8, "{map:?}");
            } else {
                assert_eq!(map, Exposure::default());
                assert!(off(&Se3::IDENTITY, &guess.world_from_camera) > 1e-4, "what exposure does seems a motion");
            }
        }
        assert_eq!(Against::Map as usize, 1);
    }
}
