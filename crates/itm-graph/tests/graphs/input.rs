//! What a graph refuses, and that nothing makes it panic.

use itm_core::{PoseError, Se3};
use itm_graph::{Edge, Error, Kernel, NodeId, Options, PoseGraph, information};
use nalgebra::Matrix6;
use proptest::prelude::*;

use crate::{ahead, row};

const A: NodeId = NodeId(0);
const B: NodeId = NodeId(1);

fn refusal(edge: Edge) -> Error {
    let mut graph = row(2);
    let before = graph.clone();
    let error = graph.add_edge(edge).unwrap_err();
    assert_eq!(graph, before, "nothing of a refused edge stays");
    error
}

fn edge() -> Edge {
    Edge::closure(A, B, ahead(1.0), information(0.1, 0.1))
}

#[test]
fn nodes_are_checked() {
    let mut graph = row(2);
    assert_eq!(graph.add_node(B, Se3::IDENTITY), Err(Error::DuplicateNode { id: B }));
    let nan = Se3 { translation: glam::DVec3::NAN, ..Se3::IDENTITY };
    let refused = Err(Error::Pose { id: NodeId(9), reason: PoseError::NotFinite });
    assert_eq!(graph.add_node(NodeId(9), nan), refused);
    assert!(graph.set_pose(B, nan).is_err() && graph == row(2));
    let unknown = Error::UnknownNode { id: NodeId(9) };
    assert_eq!(graph.pose(NodeId(9)), Err(unknown.clone()));
    assert_eq!(graph.set_fixed(NodeId(9), true), Err(unknown));
}

#[test]
fn edges_are_checked() {
    let missing = Error::UnknownEnd { from: A, to: NodeId(7), missing: NodeId(7) };
    assert_eq!(refusal(Edge { to: NodeId(7), ..edge() }), missing);
    assert_eq!(refusal(Edge { to: A, ..edge() }), Error::SelfEdge { id: A });
    let infinite = Se3 { translation: glam::DVec3::INFINITY, ..Se3::IDENTITY };
    let reason = PoseError::NotFinite;
    assert_eq!(refusal(Edge { from_from_to: infinite, ..edge() }), Error::Measurement { from: A, to: B, reason });
    for value in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refusal(Edge { kernel: Kernel::Huber(value), ..edge() }), Error::KernelParameter { .. }));
    }
}

#[test]
fn informations_are_checked() {
    let with = |row, column, value| {
        let mut information = information(0.1, 0.1);
        information[(row, column)] = value;
        Edge { information, ..edge() }
    };
    let error = refusal(with(4, 1, f64::NAN)).to_string();
    assert!(error.contains("node 0 to node 1") && error.contains("row 4, column 1"), "{error}");
    let error = refusal(with(4, 1, 1.0));
    assert_eq!(error, Error::InformationNotSymmetric { from: A, to: B, row: 4, column: 1, difference: 1.0 });
    let error = refusal(with(5, 5, -2.0));
    assert!(matches!(error, Error::InformationNotPositive { eigenvalue, .. } if (eigenvalue + 2.0).abs() < 1e-9));
    // Semidefinite is fine, and so are printed digits.
    row(2).add_edge(with(5, 5, 0.0)).unwrap();
    row(2).add_edge(with(4, 1, 1e-5)).unwrap();
    row(2).add_edge(Edge { information: Matrix6::from_element(1.0), ..edge() }).unwrap();
}

#[test]
fn options_are_checked() {
    for options in [
        Options { cost_tolerance: f64::NAN, ..Options::default() },
        Options { step_tolerance: -1.0, ..Options::default() },
        Options { initial_damping: 0.0, ..Options::default() },
    ] {
        assert!(matches!(row(2).optimise(&options), Err(Error::Option { .. })));
    }
}

#[test]
fn distances_beyond_numbers_are_an_error() {
    let mut graph = row(2);
    graph.set_pose(B, ahead(1e200)).unwrap();
    let before = graph.clone();
    assert_eq!(graph.optimise(&Options::default()), Err(Error::CostNotFinite { from: A, to: B }));
    assert_eq!(graph, before);
}

#[test]
fn a_system_beyond_numbers_stalls() {
    // The cost is finite, but a rotation of node 0 moves node 1 so far that the Hessian is not.
    let mut graph = row(1);
    graph.add_node(B, ahead(1.1e160)).unwrap();
    graph.add_node(NodeId(2), Se3::IDENTITY).unwrap();
    for id in [A, NodeId(2)] {
        graph.add_edge(Edge::sequential(id, B, ahead(1e160), information(3e5, 1.0))).unwrap();
    }
    let report = graph.optimise(&Options::default()).unwrap();
    assert!(!report.converged() && report.final_cost.is_finite(), "{report:?}");
    assert!(graph.nodes().iter().all(|node| node.world_from_node.is_finite()));
}

proptest! {
    #[test]
    fn any_graph_ends_with_finite_poses_and_no_higher_cost(
        poses in prop::collection::vec(prop::array::uniform6(-4.0..4.0f64), 1..8),
        edges in prop::collection::vec((0..8u64, 0..8u64, prop::array::uniform6(-4.0..4.0f64), 0..4usize, -8..8), 0..20),
        fixed in prop::collection::vec(0..8u64, 0..3),
    ) {
        let mut graph = PoseGraph::new();
        for (id, pose) in poses.iter().enumerate() {
            graph.add_node(NodeId(id as u64), Se3::exp(*pose)).unwrap();
        }
        let nodes = poses.len() as u64;
        for id in fixed {
            graph.set_fixed(NodeId(id % nodes), true).unwrap();
        }
        for (a, b, motion, kernel, digits) in edges {
            let kernel = [Kernel::None, Kernel::Huber(1.0), Kernel::Cauchy(2.0), Kernel::DynamicScaling { phi: 5.0 }][kernel];
            // Of rank one, or tiny, or huge.
            let information = Matrix6::from_element(10f64.powi(digits));
            let edge = Edge { kernel, information, ..Edge::closure(NodeId(a % nodes), NodeId(b % nodes), Se3::exp(motion), Matrix6::zeros()) };
            let _ = graph.add_edge(edge);
        }
        let report = graph.optimise(&Options { max_iterations: 30, ..Options::default() }).unwrap();
        prop_assert!(report.final_cost <= report.initial_cost);
        prop_assert!(graph.nodes().iter().all(|node| node.world_from_node.is_finite()));
        let _ = graph.marginals();
    }
}
