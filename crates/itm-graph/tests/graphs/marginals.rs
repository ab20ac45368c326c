//! Covariances, and what they say about a closure.

use itm_core::Se3;
use itm_graph::{Edge, Error, NodeId, Options, PoseGraph, information};
use nalgebra::{Matrix6, Vector6};

use crate::problems::{Shape, Spec};
use crate::{ahead, row};

#[test]
fn a_row_adds_up_its_steps() {
    let graph = row(3);
    let mut marginals = graph.marginals().unwrap();
    assert_eq!(marginals.node(NodeId(0)).unwrap(), Matrix6::zeros());
    let (t, r) = (1e-4, 25e-6);
    let one = marginals.between(NodeId(1), NodeId(2)).unwrap();
    assert!((one - Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r))).amax() < 1e-12, "{one}");
    // A rotation at node 1 swings node 2, a metre ahead, sideways.
    let two = marginals.between(NodeId(0), NodeId(2)).unwrap();
    let expected = Vector6::new(2.0 * t + r, 2.0 * t + r, 2.0 * t, 2.0 * r, 2.0 * r, 2.0 * r);
    assert!((two.diagonal() - expected).amax() < 1e-12, "{two}");
    assert!((two - marginals.node(NodeId(2)).unwrap()).amax() < 1e-12);
}

#[test]
fn measuring_in_the_other_direction_carries_the_covariance() {
    let mut problem = Spec::new(Shape::Grid { nodes: 60 }, (0.02, 0.01)).make();
    problem.graph.optimise(&Options::default()).unwrap();
    let (a, b) = (NodeId(7), NodeId(41));
    let b_from_a = problem.graph.pose(b).unwrap().inverse() * problem.graph.pose(a).unwrap();
    let mut marginals = problem.graph.marginals().unwrap();
    let (there, back) = (marginals.between(a, b).unwrap(), marginals.between(b, a).unwrap());
    // b_from_a exp(δ) b_from_a⁻¹, column by column: the adjoint.
    let adjoint = Matrix6::from_columns(&std::array::from_fn::<_, 6, _>(|i| {
        let delta = std::array::from_fn(|j| if i == j { 1e-3 } else { 0.0 });
        Vector6::from((b_from_a * Se3::exp(delta) * b_from_a.inverse()).log()) * 1e3
    }));
    assert!((adjoint * back * adjoint.transpose() - there).amax() < 1e-9 * there.amax().max(1.0));
}

#[test]
fn true_closures_are_near_and_false_ones_far() {
    // From odometry alone: where the nodes of a lap are is uncertain by much, yet false closures stand out.
    let noise = (0.02, 0.01);
    let spec = Spec { false_share: 0.3, ..Spec::new(Shape::Torus { windings: 8, winding: 12 }, noise) };
    let problem = spec.make();
    let odometry = problem.truth.len() - 1;
    let mut graph = problem.graph.clone();
    graph.retain_edges(|edge| edge.from.0 + 1 == edge.to.0);
    assert_eq!(graph.edges().len(), odometry);
    let mut marginals = graph.marginals().unwrap();
    let distances: Vec<f64> =
        problem.graph.edges().iter().map(|edge| marginals.mahalanobis_squared(edge).unwrap()).collect();
    let closures = &distances[odometry..problem.true_edges];
    let mean = closures.iter().sum::<f64>() / closures.len() as f64;
    assert!(mean > 3.0 && mean < 12.0, "{mean} for 6 degrees of freedom");
    let within = |distances: &[f64]| distances.iter().filter(|d| **d < 22.5).count() as f64 / distances.len() as f64;
    assert!(within(closures) > 0.95, "{}", within(closures));
    assert!(within(&distances[problem.true_edges..]) < 0.1);
}

#[test]
fn what_is_not_determined_has_no_covariance() {
    let mut graph = row(2);
    graph.add_node(NodeId(5), ahead(9.0)).unwrap();
    let refused = Error::NotConnected { a: NodeId(0), b: NodeId(5) };
    assert_eq!(graph.marginals().unwrap().between(NodeId(0), NodeId(5)), Err(refused));
    graph.set_fixed(NodeId(5), true).unwrap();
    assert!(graph.marginals().unwrap().between(NodeId(0), NodeId(5)).is_err(), "one of two parts is held only");
    graph.set_fixed(NodeId(0), true).unwrap();
    assert_eq!(graph.marginals().unwrap().between(NodeId(0), NodeId(5)), Ok(Matrix6::zeros()));
    assert_eq!(graph.marginals().unwrap().node(NodeId(6)), Err(Error::UnknownNode { id: NodeId(6) }));

    let mut partly = information(0.1, 0.1);
    partly[(4, 4)] = 0.0;
    graph.add_node(NodeId(6), ahead(10.0)).unwrap();
    graph.add_edge(Edge::sequential(NodeId(5), NodeId(6), ahead(1.0), partly)).unwrap();
    assert_eq!(graph.marginals().err(), Some(Error::Undetermined));
    assert!(PoseGraph::new().marginals().is_ok());
}
