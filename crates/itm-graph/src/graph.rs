//! The graph itself: nodes with poses, edges with measurements.

use std::collections::BTreeMap;
use std::fmt;

use itm_core::Se3;

use crate::edge::unit_pose;
use crate::{Edge, Error};

/// Names a node. Any number, in any order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u64);

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Something that has a pose: a submap, a keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Its name.
    pub id: NodeId,
    /// Where it is.
    pub world_from_node: Se3,
    /// Whether optimising leaves it where it is.
    pub fixed: bool,
}

/// Nodes, edges between them, and where the nodes are thought to be.
///
/// What it holds is consistent: every edge ends at two nodes that are there, and all numbers are finite.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    nodes: Vec<Node>,
    index: BTreeMap<NodeId, usize>,
    edges: Vec<Edge>,
    /// For each edge, the indices of its nodes `from` and `to`.
    ends: Vec<[usize; 2]>,
}

impl PoseGraph {
    /// A graph of nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a node that optimising may move.
    ///
    /// # Errors
    /// Where the id is taken or the pose is no rigid motion.
    pub fn add_node(&mut self, id: NodeId, world_from_node: Se3) -> Result<(), Error> {
        let world_from_node = unit_pose(world_from_node).map_err(|reason| Error::Pose { id, reason })?;
        if self.index.contains_key(&id) {
            return Err(Error::DuplicateNode { id });
        }
        self.index.insert(id, self.nodes.len());
        self.nodes.push(Node { id, world_from_node, fixed: false });
        Ok(())
    }

    /// Adds an edge between two nodes that are there. There may be several between the same two.
    ///
    /// # Errors
    /// Where an end is missing, both are the same, the measurement is no rigid motion, the information is not finite,
    /// symmetric and positive semidefinite (each up to 1e-6 of its largest number), or the kernel's parameter is no
    /// width.
    pub fn add_edge(&mut self, edge: Edge) -> Result<(), Error> {
        let end = |missing| {
            self.index.get(&missing).copied().ok_or(Error::UnknownEnd { from: edge.from, to: edge.to, missing })
        };
        let ends = [end(edge.from)?, end(edge.to)?];
        self.edges.push(edge.checked()?);
        self.ends.push(ends);
        Ok(())
    }

    /// Fixes a node where it is, or lets it move again. Where a part of the graph has no fixed node, optimising holds the
    /// first that was added of that part.
    ///
    /// # Errors
    /// Where there is no such node.
    pub fn set_fixed(&mut self, id: NodeId, fixed: bool) -> Result<(), Error> {
        let at = self.find(id)?;
        self.nodes[at].fixed = fixed;
        Ok(())
    }

    /// Moves a node, fixed or not.
    ///
    /// # Errors
    /// Where there is no such node or the pose is no rigid motion.
    pub fn set_pose(&mut self, id: NodeId, world_from_node: Se3) -> Result<(), Error> {
        let at = self.find(id)?;
        self.nodes[at].world_from_node = unit_pose(world_from_node).map_err(|reason| Error::Pose { id, reason })?;
        Ok(())
    }

    /// Removes the edges that `keep` denies, as those that a [`Report`](crate::Report) names as false.
    pub fn retain_edges(&mut self, mut keep: impl FnMut(&Edge) -> bool) {
        let kept: Vec<bool> = self.edges.iter().map(&mut keep).collect();
        let mut keep = kept.iter();
        self.edges.retain(|_| keep.next() == Some(&true));
        let mut keep = kept.iter();
        self.ends.retain(|_| keep.next() == Some(&true));
    }

    /// Where a node is.
    ///
    /// # Errors
    /// Where there is no such node.
    pub fn pose(&self, id: NodeId) -> Result<Se3, Error> {
        Ok(self.nodes[self.find(id)?].world_from_node)
    }

    /// All nodes, in the order in which they were added.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// All edges, in the order in which they were added.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The cost `½ Σ ρ(χ²)` of the poses as they are; without a unit.
    pub fn cost(&self) -> f64 {
        self.cost_at(&self.poses())
    }

    /// A node's place among [`PoseGraph::nodes`].
    pub(crate) fn find(&self, id: NodeId) -> Result<usize, Error> {
        self.index.get(&id).copied().ok_or(Error::UnknownNode { id })
    }

    /// For each edge, the places of its nodes.
    pub(crate) fn ends(&self) -> &[[usize; 2]] {
        &self.ends
    }

    pub(crate) fn poses(&self) -> Vec<Se3> {
        self.nodes.iter().map(|node| node.world_from_node).collect()
    }

    pub(crate) fn set_poses(&mut self, poses: &[Se3]) {
        for (node, pose) in self.nodes.iter_mut().zip(poses) {
            node.world_from_node = *pose;
        }
    }

    /// `χ²` of each edge with the nodes at other poses than their own.
    pub(crate) fn chi2_at<'a>(&'a self, poses: &'a [Se3]) -> impl Iterator<Item = f64> + 'a {
        self.edges.iter().zip(&self.ends).map(|(edge, [from, to])| edge.error(&poses[*from], &poses[*to]).1)
    }

    /// The cost with the nodes at other poses than their own.
    pub(crate) fn cost_at(&self, poses: &[Se3]) -> f64 {
        0.5 * self.edges.iter().zip(self.chi2_at(poses)).map(|(edge, chi2)| edge.kernel.cost(chi2)).sum::<f64>()
    }
}
