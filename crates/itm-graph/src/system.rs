//! The normal equations of a graph: `H δ = -g` for steps `world_from_node * exp(δ)` of all nodes that may move.

use itm_core::Se3;
use nalgebra::Vector6;

use crate::factor::{Factor, dot};
use crate::parts::{held, parts};
use crate::sparse::{BlockMatrix, DOF, Pattern, Place};
use crate::{Error, NodeId, PoseGraph};

/// How much smaller conjugate gradients make what a step leaves, as a share of the energy `gᵀ H⁻¹ g`.
const ACCURACY: f64 = 1e-6;

/// A refinement takes as long as this many operations of a factorisation for each number of the factor: it is bound by
/// memory. So there is none for graphs with hardly a loop, whose factors are quick to find.
const OPERATIONS_OF_REFINEMENT: f64 = 25.0;

/// What was not refined enough by then seldom is soon.
const MOST_REFINEMENTS: usize = 6;

/// How much softer than the factor's the Hessian may be along a direction.
const SOFTEST: f64 = 4.0;

/// Normal equations with the pattern of one graph.
pub(crate) struct System {
    pub(crate) pattern: Pattern,
    pub(crate) hessian: BlockMatrix,
    /// By scalar row of the pattern.
    pub(crate) gradient: Vec<f64>,
    pub(crate) factor: Factor,
    /// For each node its variable, if it may move.
    variable_of: Vec<Option<usize>>,
    /// For each edge the place of its off-diagonal block, if both its nodes may move.
    places: Vec<Option<Place>>,
    /// Each node's part of the graph.
    pub(crate) parts: Vec<usize>,
    /// Nodes that are held because their part has no fixed one, by place.
    pub(crate) held: Vec<usize>,
}

impl System {
    /// Room for the equations of a graph.
    pub(crate) fn new(graph: &PoseGraph) -> Result<Self, Error> {
        let parts = parts(graph);
        let held = held(graph, &parts);
        let mut moves: Vec<bool> = graph.nodes().iter().map(|node| !node.fixed).collect();
        for node in &held {
            moves[*node] = false;
        }
        let mut variables = 0..;
        let variable_of: Vec<_> = moves.iter().map(|moves| if *moves { variables.next() } else { None }).collect();
        let pairs_of_edges = graph.ends().iter().map(|[from, to]| variable_of[*from].zip(variable_of[*to]));
        let pairs: Vec<_> = pairs_of_edges.clone().flatten().map(|(from, to)| [from, to]).collect();
        let too_large = |_| Error::OutOfMemory { nodes: graph.nodes().len(), edges: graph.edges().len() };
        let pattern = Pattern::new(moves.iter().filter(|moves| **moves).count(), &pairs).map_err(too_large)?;
        let places = pairs_of_edges.map(|pair| pair.and_then(|(from, to)| pattern.place(from, to))).collect();
        Ok(Self {
            hessian: BlockMatrix::zeros(&pattern),
            gradient: vec![0.0; pattern.size()],
            factor: Factor::new(&pattern).map_err(too_large)?,
            pattern,
            variable_of,
            places,
            parts,
            held,
        })
    }

    /// Ids of the nodes that are held because their part has no fixed one.
    pub(crate) fn held_ids(&self, graph: &PoseGraph) -> Vec<NodeId> {
        self.held.iter().map(|node| graph.nodes()[*node].id).collect()
    }

    /// Whether no node may move.
    pub(crate) fn is_empty(&self) -> bool {
        self.pattern.size() == 0
    }

    /// The scalar row of a node's first coordinate, if it may move.
    pub(crate) fn row(&self, node: usize) -> Option<usize> {
        self.variable_of[node].map(|variable| self.pattern.row(variable))
    }

    /// Fills in Hessian and gradient with the nodes at `poses`.
    pub(crate) fn linearise(&mut self, graph: &PoseGraph, poses: &[Se3]) {
        self.hessian.clear();
        self.gradient.fill(0.0);
        for ((edge, ends), place) in graph.edges().iter().zip(graph.ends()).zip(&self.places) {
            let blocks = edge.linearise(&poses[ends[0]], &poses[ends[1]]);
            let diagonals = [(&blocks.from_from, &blocks.from_gradient), (&blocks.to_to, &blocks.to_gradient)];
            for (node, (block, gradient)) in ends.iter().zip(diagonals) {
                let Some(variable) = self.variable_of[*node] else { continue };
                self.hessian.add_diagonal(&self.pattern, variable, block);
                let row = self.pattern.row(variable);
                for (sum, g) in self.gradient[row..row + DOF].iter_mut().zip(gradient.iter()) {
                    *sum += g;
                }
            }
            if let Some(place) = place {
                self.hessian.add(*place, &blocks.from_to);
            }
        }
    }

    /// Factorises the Hessian as it is. Whether it is positive definite by more than rounding.
    pub(crate) fn factorise_determined(&mut self) -> bool {
        // Of a singular matrix rounding may leave tiny positive pivots; with a little less on its diagonal it doesn't.
        let less: Vec<f64> = self.hessian.diagonal().iter().map(|d| -1e-14 * d).collect();
        self.factor.factorise(&self.pattern, &self.hessian, &less)
            && self.factor.factorise(&self.pattern, &self.hessian, &[])
    }

    /// The step by a new factor, with `added` on the Hessian's diagonal, if that is positive definite.
    pub(crate) fn solved(&mut self, added: &[f64]) -> Option<Vec<f64>> {
        let mut step: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        self.factor.factorise(&self.pattern, &self.hessian, added).then(|| {
            self.factor.solve(&self.pattern, &mut step);
            step
        })
    }

    /// The step by conjugate gradients (Hestenes and Stiefel 1952) on the equations as they are, preconditioned by the
    /// factor of an earlier Hessian, until what it leaves has an energy `rᵀ H⁻¹ r` that is `negligible` or a millionth of
    /// what it was. `None` where there is no factor, or the Hessian has become too different for it.
    ///
    /// Near a minimum the Hessian hardly changes, and the few products and solutions with the old factor that this needs
    /// take a fraction of the time of a new one.
    pub(crate) fn refined(&mut self, added: &[f64], negligible: f64) -> Option<Vec<f64>> {
        let worthwhile = self.pattern.fronts.operations_by_number() / OPERATIONS_OF_REFINEMENT;
        let most = MOST_REFINEMENTS.min(worthwhile as usize);
        if most == 0 || !self.factor.is_found() {
            return None;
        }
        let mut step = vec![0.0; self.gradient.len()];
        let mut rest: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        let mut solved = rest.clone();
        self.factor.solve(&self.pattern, &mut solved);
        let mut direction = solved.clone();
        let mut energy = dot(&rest, &solved);
        let enough = (ACCURACY * energy).max(negligible);
        for _ in 0..most {
            let mut product = self.hessian.times(&self.pattern, &direction);
            for ((p, d), x) in product.iter_mut().zip(added).zip(&direction) {
                *p += d * x;
            }
            let length = energy / dot(&direction, &product);
            for (((x, r), d), p) in step.iter_mut().zip(&mut rest).zip(&direction).zip(&product) {
                *x += length * d;
                *r -= length * p;
            }
            solved.copy_from_slice(&rest);
            self.factor.solve(&self.pattern, &mut solved);
            let left = dot(&rest, &solved);
            // Energies are as the factor sees them, which is too little where it is too stiff, as after edges were given
            // up. False for what is not a number, too.
            let is_of_use = length < SOFTEST && left < 0.5 * energy;
            if !is_of_use {
                return None;
            }
            if left <= enough {
                return Some(step);
            }
            let share = left / energy;
            for (d, z) in direction.iter_mut().zip(&solved) {
                *d = z + share * *d;
            }
            energy = left;
        }
        None
    }

    /// Poses after a step, given by scalar rows.
    pub(crate) fn moved(&self, poses: &[Se3], step: &[f64]) -> Vec<Se3> {
        let step_of = |node| self.row(node).map(|row| Vector6::from_column_slice(&step[row..row + DOF]));
        let move_one = |(node, pose): (usize, &Se3)| step_of(node).map_or(*pose, |d| *pose * Se3::exp(d.into()));
        poses.iter().enumerate().map(move_one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Edge, Kernel, information};

    /// A grid of 12 x 12 nodes, somewhat displaced, whose edges weigh less if `scaled`.
    fn grid(displaced: f64, scaled: bool) -> PoseGraph {
        let mut graph = PoseGraph::new();
        let id = |x: u64, y: u64| NodeId(12 * y + x);
        let pose = |x, y, by| {
            let turn = 0.3 * (x as f64 + 0.7 * y as f64);
            let noise = |k: f64| by * (7.0 * k + turn * 5.0).sin();
            Se3::exp([x as f64, 0.0, y as f64, 0.0, turn, 0.0])
                * Se3::exp([noise(1.0), noise(2.0), noise(3.0), noise(4.0), noise(5.0), noise(6.0)])
        };
        for (x, y) in (0..12).flat_map(|y| (0..12).map(move |x| (x, y))) {
            graph.add_node(id(x, y), pose(x, y, displaced)).unwrap();
            let left = (x > 0).then(|| (x - 1, y));
            let above = (y > 0).then(|| (x, y - 1));
            let both = (x > 0 && y > 0).then(|| (x - 1, y - 1));
            for (a, b) in [left, above, both].into_iter().flatten() {
                let measured = pose(a, b, 0.0).inverse() * pose(x, y, 0.0);
                let kernel = if scaled { Kernel::DynamicScaling { phi: 1e-6 } } else { Kernel::None };
                let edge = Edge::sequential(id(a, b), id(x, y), measured, information(0.1, 0.05));
                graph.add_edge(Edge { kernel, ..edge }).unwrap();
            }
        }
        graph
    }

    #[test]
    fn an_old_factor_solves_new_equations() {
        let (old, new) = (grid(0.001, false), grid(0.0012, false));
        let mut system = System::new(&old).unwrap();
        let added = vec![1e-3; system.pattern.size()];
        assert!(system.refined(&added, 0.0).is_none(), "there is no factor yet");
        system.linearise(&old, &old.poses());
        system.solved(&added).unwrap();
        system.linearise(&new, &new.poses());
        let refined = system.refined(&added, 0.0).unwrap();
        let solved = system.solved(&added).unwrap();
        let length = dot(&solved, &solved);
        let differences: Vec<f64> = refined.iter().zip(&solved).map(|(a, b)| a - b).collect();
        assert!(length > 1e-6 && dot(&differences, &differences) < 1e-5 * length);
        assert!(differences.iter().any(|d| *d != 0.0), "not solved by a new factor");
    }

    #[test]
    fn a_factor_that_is_too_stiff_is_of_no_use() {
        let (old, new) = (grid(0.01, false), grid(0.012, true));
        let mut system = System::new(&old).unwrap();
        let added = vec![1e-3; system.pattern.size()];
        system.linearise(&old, &old.poses());
        system.solved(&added).unwrap();
        system.linearise(&new, &new.poses());
        assert!(system.refined(&added, f64::INFINITY).is_none());
    }
}
