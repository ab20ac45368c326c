//! What can be wrong with a pose graph.

use itm_core::PoseError;
use thiserror::Error;

use crate::NodeId;

/// Why a graph, a part of one or a question about it was refused: what was expected, what was found, and where.
///
/// Each message is a whole sentence that already holds its cause, so there is no chain of sources to print behind it.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum Error {
    /// A second node with the id of an earlier one.
    #[error("the graph already has a node {id}")]
    DuplicateNode {
        /// The id.
        id: NodeId,
    },
    /// A question about a node that is not there.
    #[error("the graph has no node {id}")]
    UnknownNode {
        /// The id.
        id: NodeId,
    },
    /// An edge with an end that is not there.
    #[error("the edge from node {from} to node {to} has no node {missing} to end at")]
    UnknownEnd {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
        /// The one that is not in the graph.
        missing: NodeId,
    },
    /// An edge from a node to itself.
    #[error("an edge must join two nodes, but this one goes from node {id} to itself")]
    SelfEdge {
        /// The node.
        id: NodeId,
    },
    /// A node's pose that is no rigid motion.
    #[error("the pose of node {id} is refused: {reason}")]
    Pose {
        /// The node.
        id: NodeId,
        /// What is wrong with it.
        reason: PoseError,
    },
    /// A measured motion that is no rigid motion.
    #[error("the measurement of the edge from node {from} to node {to} is refused: {reason}")]
    Measurement {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
        /// What is wrong with it.
        reason: PoseError,
    },
    /// An information matrix with a number that is infinite, not a number, or beyond 1e100.
    #[error(
        "the information of the edge from node {from} to node {to} must have finite numbers up to 1e100, not {value} (row {row}, column {column}, from 0)"
    )]
    InformationNotFinite {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
        /// Row from 0.
        row: usize,
        /// Column from 0.
        column: usize,
        /// What stands there.
        value: f64,
    },
    /// An information matrix that differs from its transpose.
    #[error(
        "the information of the edge from node {from} to node {to} must be symmetric, but row {row}, column {column} (from 0) differs from its mirror by {difference:e}"
    )]
    InformationNotSymmetric {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
        /// Row from 0.
        row: usize,
        /// Column from 0.
        column: usize,
        /// By how much.
        difference: f64,
    },
    /// An information matrix by which some residuals would have a negative cost.
    #[error(
        "the information of the edge from node {from} to node {to} must be positive semidefinite, but it has the eigenvalue {eigenvalue:e}"
    )]
    InformationNotPositive {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
        /// The smallest eigenvalue.
        eigenvalue: f64,
    },
    /// A kernel's parameter that is no width.
    #[error(
        "the kernel of the edge from node {from} to node {to} must have a parameter between 1e-50 and 1e50, not {value}"
    )]
    KernelParameter {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
        /// The parameter given.
        value: f64,
    },
    /// Numbers that are each finite, but whose cost is not.
    #[error(
        "the cost of the edge from node {from} to node {to} is not finite: its nodes are too far apart for its information"
    )]
    CostNotFinite {
        /// The edge's first node.
        from: NodeId,
        /// The edge's second node.
        to: NodeId,
    },
    /// An option outside of what it may be.
    #[error("the option {name} must be {expected}, not {value}")]
    Option {
        /// The field's name in [`Options`](crate::Options).
        name: &'static str,
        /// What would do.
        expected: &'static str,
        /// What was given.
        value: f64,
    },
    /// A covariance between nodes that no chain of edges joins, neither directly nor through fixed nodes.
    #[error("nodes {a} and {b} have no covariance: neither edges nor fixed nodes join them")]
    NotConnected {
        /// One node.
        a: NodeId,
        /// The other.
        b: NodeId,
    },
    /// Edges that leave some motion of the nodes without information.
    #[error("the graph has no covariances: its edges leave some motion of its nodes undetermined")]
    Undetermined,
    /// A system that this machine cannot hold.
    #[error("the normal equations of {nodes} nodes and {edges} edges do not fit into memory")]
    OutOfMemory {
        /// Number of nodes.
        nodes: usize,
        /// Number of edges.
        edges: usize,
    },
    /// A line of a g2o text that is not of its format.
    #[error("'{name}', line {line}: expected {expected}, found {found}")]
    Line {
        /// The file's name as given.
        name: String,
        /// Line number, from 1.
        line: usize,
        /// What would do.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// A line of a g2o text that is well formed, but that no graph can hold.
    #[error("'{name}', line {line}: {reason}")]
    Content {
        /// The file's name as given.
        name: String,
        /// Line number, from 1.
        line: usize,
        /// Why the graph refused it.
        reason: Box<Error>,
    },
}
