//! The normal equations of a graph: `H δ = -g` for steps `world_from_node * exp(δ)` of all nodes that may move.

use itm_core::Se3;
use nalgebra::Vector6;

use crate::factor::Factor;
use crate::parts::{held, parts};
use crate::sparse::{BlockMatrix, DOF, Pattern, Place};
use crate::{Error, NodeId, PoseGraph};

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

    /// Poses after a step, given by scalar rows.
    pub(crate) fn moved(&self, poses: &[Se3], step: &[f64]) -> Vec<Se3> {
        let step_of = |node| self.row(node).map(|row| Vector6::from_column_slice(&step[row..row + DOF]));
        let move_one = |(node, pose): (usize, &Se3)| step_of(node).map_or(*pose, |d| *pose * Se3::exp(d.into()));
        poses.iter().enumerate().map(move_one).collect()
    }
}
