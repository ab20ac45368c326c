//! One optimiser for every tracker: Levenberg-Marquardt steps on reweighted least squares, from coarse to fine (Levenberg
//! 1944, Marquardt 1963; the report, section 3.1).

use glam::DVec3;
use itm_core::Se3;
use nalgebra::Vector6;

use super::{Evaluation, Guess, LevelPlan, Noise, NormalEquations, Objective, Plan};

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
            for (start, guess) in starts.iter().enumerate() {
                let end = descend(objective, guess, level, plan, noise)?;
                outcome.evaluations[index] += end.evaluations;
                // Another start must be better by more than rounding, so that ties are held at the first one.
                if best.as_ref().is_none_or(|b| end.equations.cost_of_all < 0.98 * b.equations.cost_of_all) {
                    outcome.start = start;
                    best = Some(end);
                }
            }
            best
        } else {
            let end = descend(objective, &outcome.guess, level, plan, noise)?;
            outcome.evaluations[index] += end.evaluations;
            Some(end)
        };
        let Some(end) = found else { continue };
        outcome.guess = end.guess;
        outcome.held = end.held;
        outcome.last = end.evaluation;
        outcome.equations = Some(end.equations);
    }
    Ok(outcome)
}

/// Where a level ended.
struct LevelEnd {
    guess: Guess,
    evaluation: Evaluation,
    equations: NormalEquations,
    evaluations: u32,
    held: usize,
}

fn descend(
    objective: &mut dyn Objective,
    start: &Guess,
    level: &LevelPlan,
    plan: &Plan,
    noise: &Noise,
) -> Result<LevelEnd, itm_gpu::Error> {
    let mut request = level.request;
    for (term, sigma) in request.colour.iter_mut().zip(noise.colour) {
        // Before the images are aligned, differences are larger than the noise.
        if let Some(term) = term.as_mut().filter(|_| level.finest) {
            term.cutoff = term.cutoff.min((plan.tukey_cutoff * sigma) as f32);
        }
    }
    let mut guess = *start;
    let pivot = objective.pivot();
    let mut evaluate = |guess: &Guess| {
        let evaluation = objective.evaluate(guess, &request)?;
        Ok::<_, itm_gpu::Error>((evaluation, NormalEquations::new(&evaluation, &request, plan, noise)))
    };
    let (mut evaluation, mut equations) = evaluate(&guess)?;
    let mut evaluations = 1;
    let (mut damping, mut held) = (0.0, 0);
    for _ in 0..level.max_steps {
        if pairs(&evaluation) < plan.min_pairs {
            break;
        }
        let Some((step, held_now)) = equations.step(level.part, damping, plan.min_information) else { break };
        held = held_now;
        let candidate = Guess {
            world_from_camera: moved(&guess.world_from_camera, pivot, &step),
            exposure: equations.exposures(&guess, &step),
        };
        if step.norm() < plan.min_step {
            guess = candidate;
            break;
        }
        let (there, equations_there) = evaluate(&candidate)?;
        evaluations += 1;
        if equations_there.cost <= equations.cost {
            let small = equations.cost - equations_there.cost < plan.min_decrease * equations.cost;
            (guess, evaluation, equations) = (candidate, there, equations_there);
            damping *= 0.1;
            if small {
                break;
            }
        } else {
            damping = f64::max(damping * 10.0, 1e-2);
            if damping > 1e3 {
                break;
            }
        }
    }
    tracing::trace!(
        level = level.request.level,
        evaluations,
        held,
        damping,
        cost = equations.cost,
        pairs = pairs(&evaluation),
        information = ?equations.information(),
        ?noise,
        exposure = ?guess.exposure,
        "a level ended"
    );
    Ok(LevelEnd { guess, evaluation, equations, evaluations, held })
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
