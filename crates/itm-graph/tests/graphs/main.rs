//! Whole graphs through the public API.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod agreement;
mod closures;
mod convergence;
mod input;
mod marginals;
mod problems;
mod text;

use itm_core::Se3;
use itm_graph::{Edge, NodeId, PoseGraph, information};

/// Motion along z, in metres.
fn ahead(z: f64) -> Se3 {
    Se3::exp([0.0, 0.0, z, 0.0, 0.0, 0.0])
}

/// Nodes 0, 1, 2, ... in a row, a metre apart, that know of each other by exact odometry of 1 cm and 5 mrad.
fn row(nodes: u64) -> PoseGraph {
    let mut graph = PoseGraph::new();
    for id in 0..nodes {
        graph.add_node(NodeId(id), ahead(id as f64)).unwrap();
    }
    for id in 1..nodes {
        let step = Edge::sequential(NodeId(id - 1), NodeId(id), ahead(1.0), information(0.01, 0.005));
        graph.add_edge(step).unwrap();
    }
    graph
}
