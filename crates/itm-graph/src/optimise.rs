//! Levenberg-Marquardt over all poses of a graph.

use itm_core::Se3;
use tracing::debug;

use crate::sparse::DOF;
use crate::start::along_shortest_ways;
use crate::system::System;
use crate::{Edge, EdgeKind, Error, NodeId, PoseGraph};

/// When to stop optimising, and how carefully to start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Most steps, taken and refused.
    pub max_iterations: usize,
    /// Converged once a step can lower the cost by no more than this share of it.
    pub cost_tolerance: f64,
    /// Converged once a step moves no node by more than this, in metres and radians.
    pub step_tolerance: f64,
    /// Damping of the first step, as a share of the Hessian's diagonal (Marquardt 1963). Little keeps closer to
    /// Gauss-Newton, much closer to small steps downhill.
    pub initial_damping: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { max_iterations: 100, cost_tolerance: 1e-7, step_tolerance: 1e-9, initial_damping: 1e-6 }
    }
}

impl Options {
    fn check(&self) -> Result<(), Error> {
        for (name, value) in [("cost_tolerance", self.cost_tolerance), ("step_tolerance", self.step_tolerance)] {
            if !(0.0..1.0).contains(&value) {
                return Err(Error::Option { name, expected: "at least 0 and below 1", value });
            }
        }
        if !(1e-15..=1e9).contains(&self.initial_damping) {
            let value = self.initial_damping;
            return Err(Error::Option { name: "initial_damping", expected: "between 1e-15 and 1e9", value });
        }
        Ok(())
    }
}

/// Why optimising stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// At a minimum, within the tolerances.
    Converged,
    /// After [`Options::max_iterations`]. Optimising again goes on from here.
    IterationLimit,
    /// No step, however short, lowers the cost any more: the tolerances ask for more than numbers can give.
    Stalled,
}

/// How well one edge agrees with where its nodes are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeReport {
    /// The edge's first node.
    pub from: NodeId,
    /// The edge's second node.
    pub to: NodeId,
    /// How the edge came about.
    pub kind: EdgeKind,
    /// `eᵀ Ω e`, without the kernel. For a true measurement 6 or less on average, and above 22.5 at most once in a
    /// thousand.
    pub chi2: f64,
    /// What the kernel left of the edge's information, from 0 to 1: for dynamic covariance scaling, `s²`. A closure
    /// near zero is one that the others contradict.
    pub weight: f64,
}

/// What optimising did.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Why it stopped.
    pub outcome: Outcome,
    /// Steps, taken and refused. Each solves the normal equations once, the last ones often without a new factor.
    pub iterations: usize,
    /// Cost `½ Σ ρ(χ²)` before.
    pub initial_cost: f64,
    /// Cost after; never above the one before.
    pub final_cost: f64,
    /// Nodes that were held though nobody fixed them, because nothing else holds their part of the graph. More than
    /// one means that the graph has fallen apart: where the parts lie to each other is as it was before.
    pub held: Vec<NodeId>,
    /// Each edge, in the order of [`PoseGraph::edges`].
    pub edges: Vec<EdgeReport>,
}

impl Report {
    /// Whether it stopped at a minimum.
    pub fn converged(&self) -> bool {
        self.outcome == Outcome::Converged
    }
}

/// A step that lowers the cost by a smaller share may change the Hessian so little that its factor serves for the next.
const NEAR: f64 = 0.25;

/// What the solution of the normal equations may leave of a step, as a share of what counts as converged.
const NEGLIGIBLE: f64 = 1e-3;

/// Damping beyond which no step is long enough to matter.
const MOST_DAMPING: f64 = 1e16;

impl PoseGraph {
    /// Moves the nodes to where the cost has a minimum, by Levenberg-Marquardt (Levenberg 1944; Marquardt 1963) with the
    /// damping of Nielsen 1999 (*Damping Parameter in Marquardt's Method*).
    ///
    /// Poses are changed on the right, `world_from_node * exp(δ)`, with analytic derivatives. The same graph and options
    /// give the same bits on the same machine.
    ///
    /// It starts from where the nodes are, or from where edges without kernels put them, from what is fixed along the ways
    /// of the least uncertain rotation, if that costs less: far less where poses come from odometry with its errors
    /// added up.
    ///
    /// # Errors
    /// Where an option or the cost that the poses start from is not usable, or memory is short; nothing has moved then.
    pub fn optimise(&mut self, options: &Options) -> Result<Report, Error> {
        options.check()?;
        let mut poses = self.poses();
        let initial_cost = self.cost_at(&poses);
        if !initial_cost.is_finite() {
            return Err(self.infinite_edge(&poses));
        }
        let mut system = System::new(self)?;
        let mut cost = initial_cost;
        if let Some(others) = along_shortest_ways(self, &system.held) {
            let other_cost = self.cost_at(&others);
            if other_cost < cost {
                (poses, cost) = (others, other_cost);
            }
        }
        let (outcome, iterations, final_cost) = self.descend(&mut system, &mut poses, cost, options);
        let held = system.held_ids(self);
        let report_of = |(edge, chi2): (&Edge, f64)| EdgeReport {
            from: edge.from,
            to: edge.to,
            kind: edge.kind,
            chi2,
            weight: edge.kernel.weight(chi2),
        };
        let edges = self.edges().iter().zip(self.chi2_at(&poses)).map(report_of).collect();
        self.set_poses(&poses);
        debug!(?outcome, iterations, initial_cost, final_cost, held = held.len(), "optimised a pose graph");
        Ok(Report { outcome, iterations, initial_cost, final_cost, held, edges })
    }

    /// The loop: outcome, iterations and cost.
    fn descend(
        &self,
        system: &mut System,
        poses: &mut Vec<Se3>,
        mut cost: f64,
        options: &Options,
    ) -> (Outcome, usize, f64) {
        if system.is_empty() {
            return (Outcome::Converged, 0, cost);
        }
        system.linearise(self, poses);
        let mut is_near = false;
        let mut damping = Damping { factor: options.initial_damping, growth: 2.0 };
        for iteration in 1..=options.max_iterations {
            let negligible = is_near.then_some(NEGLIGIBLE * options.cost_tolerance * cost);
            let Some((step, predicted)) = damped_step(system, damping.factor, negligible) else {
                damping.raise();
                if damping.factor > MOST_DAMPING {
                    return (Outcome::Stalled, iteration, cost);
                }
                continue;
            };
            let moved = system.moved(poses, &step);
            let moved_cost = self.cost_at(&moved);
            // False for costs that are not finite, too.
            let lower = moved_cost <= cost;
            debug!(iteration, cost, moved_cost, predicted, damping = damping.factor, "a step of a pose graph");
            let negligible =
                predicted <= options.cost_tolerance * cost || step.iter().all(|x| x.abs() <= options.step_tolerance);
            if lower {
                is_near = cost - moved_cost < NEAR * cost;
                damping.lower((cost - moved_cost) / predicted);
                (*poses, cost) = (moved, moved_cost);
            } else {
                damping.raise();
            }
            // A refused step that is small by its damping alone says nothing about convergence.
            if negligible && (lower || damping.factor < 1.0) {
                return (Outcome::Converged, iteration, cost);
            }
            if damping.factor > MOST_DAMPING {
                return (Outcome::Stalled, iteration, cost);
            }
            if lower {
                system.linearise(self, poses);
            }
        }
        (Outcome::IterationLimit, options.max_iterations, cost)
    }

    /// The first edge whose cost is not finite, as an error.
    fn infinite_edge(&self, poses: &[Se3]) -> Error {
        let is_infinite = |(edge, chi2): &(&Edge, f64)| !edge.kernel.cost(*chi2).is_finite();
        let found = self.edges().iter().zip(self.chi2_at(poses)).find(is_infinite);
        // Where each is finite and only the sum is not, the last one is as good as any.
        let edge = found.map(|(edge, _)| edge).or(self.edges().last()).expect("a sum of no edges is zero");
        Error::CostNotFinite { from: edge.from, to: edge.to }
    }
}

/// Nielsen's damping: a parameter that falls as smoothly as steps succeed and grows ever faster while they fail.
struct Damping {
    factor: f64,
    growth: f64,
}

impl Damping {
    /// After a step that lowered the cost by `gain` times what was predicted.
    fn lower(&mut self, gain: f64) {
        let factor = self.factor * (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0);
        *self = Self { factor: factor.max(1e-15), growth: 2.0 };
    }

    /// After a step that did not.
    fn raise(&mut self) {
        self.factor *= self.growth;
        self.growth *= 2.0;
    }
}

/// The step and by how much the quadratic model says it lowers the cost, or `None` without a factor.
/// Given what energy is `negligible`, the factor of an earlier step serves if it can.
fn damped_step(system: &mut System, damping: f64, negligible: Option<f64>) -> Option<(Vec<f64>, f64)> {
    let mut added = system.hessian.diagonal();
    // Directions without any information must not move, and need a positive diagonal for that. Metres and radians each
    // have their own scale.
    let mut largest = [f64::MIN_POSITIVE; 2];
    for (row, diagonal) in added.iter().enumerate() {
        let unit = row % DOF / 3;
        largest[unit] = diagonal.max(largest[unit]);
    }
    for (row, diagonal) in added.iter_mut().enumerate() {
        *diagonal = damping * diagonal.max(1e-12 * largest[row % DOF / 3]);
    }
    // An infinite diagonal would have a factor all the same, and steps of zero that look like convergence.
    if !added.iter().all(|d| d.is_finite()) {
        return None;
    }
    let step = match negligible.and_then(|negligible| system.refined(&added, negligible)) {
        Some(step) => step,
        None => system.solved(&added)?,
    };
    // ½ δᵀ (D δ - g), from (H + D) δ = -g.
    let terms = step.iter().zip(&added).zip(&system.gradient).map(|((x, d), g)| 0.5 * x * (d * x - g));
    let predicted = terms.sum::<f64>();
    step.iter().all(|x| x.is_finite()).then_some((step, predicted))
}
