//! How well the poses of a graph are known.

use nalgebra::Matrix6;

use crate::sparse::DOF;
use crate::system::System;
use crate::tangent::{adjoint, right_jacobian_inverse};
use crate::{Edge, Error, NodeId, PoseGraph};

/// Covariances of a graph's poses, as they were when [`PoseGraph::marginals`] was called: one factorisation for any
/// number of questions.
///
/// They are the inverse of the normal equations' matrix (Kümmerle et al. 2011): what the edges' informations say, weighted
/// by their kernels, where the nodes are. That is meant for a graph at its minimum. All are covariances of twists
/// `(v, ω)` on the right, `pose * exp(error)`: metres first, then radians.
pub struct Marginals<'a> {
    graph: &'a PoseGraph,
    system: System,
}

impl PoseGraph {
    /// Makes ready to tell how well poses are known.
    ///
    /// # Errors
    /// [`Error::Undetermined`] where the edges leave something open; where memory is short.
    pub fn marginals(&self) -> Result<Marginals<'_>, Error> {
        let mut system = System::new(self)?;
        if !system.is_empty() {
            system.linearise(self, &self.poses());
            if !system.factorise_determined() {
                return Err(Error::Undetermined);
            }
        }
        Ok(Marginals { graph: self, system })
    }
}

impl Marginals<'_> {
    /// Covariance of a node's pose in the frame of the node, given its part's fixed nodes (or the one that is held, as
    /// [`Report::held`](crate::Report::held) describes). Zero for those themselves.
    ///
    /// # Errors
    /// Where there is no such node.
    pub fn node(&mut self, id: NodeId) -> Result<Matrix6<f64>, Error> {
        let node = self.graph.find(id)?;
        Ok(self.joint([node])[0][0])
    }

    /// Covariance of where `b` lies seen from `a`, of `world_from_a⁻¹ * world_from_b`, in the frame of `b`.
    ///
    /// # Errors
    /// Where there is no such node, or nothing joins the two.
    pub fn between(&mut self, a: NodeId, b: NodeId) -> Result<Matrix6<f64>, Error> {
        let nodes = [self.graph.find(a)?, self.graph.find(b)?];
        if !self.are_joined(nodes) {
            return Err(Error::NotConnected { a, b });
        }
        let [[aa, ab], [_, bb]] = self.joint(nodes);
        let [world_from_a, world_from_b] = nodes.map(|node| self.graph.nodes()[node].world_from_node);
        // exp(-δ_a) a_from_b exp(δ_b) = a_from_b exp(δ_b - adjoint(b_from_a) δ_a), to first order.
        let carried = adjoint(&(world_from_b.inverse() * world_from_a));
        let cross = carried * ab;
        let covariance = carried * aa * carried.transpose() - cross - cross.transpose() + bb;
        Ok(0.5 * (covariance + covariance.transpose()))
    }

    /// The squared Mahalanobis distance of a measurement that is not in the graph from what the graph says: chi-squared
    /// with 6 degrees of freedom for a true one, above 16.8 once in a hundred and above 22.5 once in a thousand. Kind and
    /// kernel of the edge do not matter.
    ///
    /// # Errors
    /// Where an end is missing, nothing joins the two, or the edge is one that
    /// [`PoseGraph::add_edge`] would refuse.
    pub fn mahalanobis_squared(&mut self, edge: &Edge) -> Result<f64, Error> {
        let edge = edge.clone().checked()?;
        let covariance = self.between(edge.from, edge.to)?;
        let (residual, _) = edge.error(&self.graph.pose(edge.from)?, &self.graph.pose(edge.to)?);
        let jacobian = right_jacobian_inverse(&residual);
        let predicted = jacobian * covariance * jacobian.transpose();
        // (P + Ω⁻¹)⁻¹ = Ω (I + P Ω)⁻¹, which does without the inverse of a semidefinite Ω.
        let mixed = Matrix6::identity() + predicted * edge.information;
        let solved = mixed.lu().solve(&residual).ok_or(Error::Undetermined)?;
        Ok(residual.dot(&(edge.information * solved)).max(0.0))
    }

    /// Whether the relative pose of two nodes is determined: within a part, or through fixed nodes of both parts.
    fn are_joined(&self, nodes: [usize; 2]) -> bool {
        let [a, b] = nodes.map(|node| self.system.parts[node]);
        // The first node of a part is what is held of it, if anything is.
        a == b || [a, b].iter().all(|part| self.system.held.binary_search(part).is_err())
    }

    /// Blocks of the joint covariance of some nodes.
    fn joint<const N: usize>(&mut self, nodes: [usize; N]) -> [[Matrix6<f64>; N]; N] {
        let size = self.system.pattern.size();
        let rows = nodes.map(|node| self.system.row(node));
        let mut columns = vec![0.0; size * N * DOF];
        for (n, row) in rows.iter().enumerate() {
            for (i, row) in row.iter().flat_map(|row| *row..row + DOF).enumerate() {
                columns[(n * DOF + i) * size + row] = 1.0;
            }
        }
        if size > 0 {
            self.system.factor.solve(&self.system.pattern, &mut columns);
        }
        let block = |row: Option<usize>, n: usize| match row {
            Some(row) => Matrix6::from_fn(|i, j| columns[(n * DOF + j) * size + row + i]),
            None => Matrix6::zeros(),
        };
        rows.map(|row| std::array::from_fn(|n| block(row, n)))
    }
}
