//! From noisy odometry to the minimum, and the minimum to the truth.

use itm_core::Se3;
use itm_graph::{Edge, NodeId, Options, Outcome, PoseGraph, information};

use crate::problems::{Shape, Spec};
use crate::{ahead, row};

const SHAPES: [Shape; 3] =
    [Shape::Sphere { laps: 15, lap: 15 }, Shape::Torus { windings: 15, winding: 15 }, Shape::Grid { nodes: 225 }];

/// Standard deviations per step of a good and of a bad odometry. The latter ends tens of metres off.
const NOISES: [(f64, f64); 2] = [(0.02, 0.01), (0.1, 0.05)];

#[test]
fn the_minimum_is_found_from_odometry() {
    for (shape, noise) in SHAPES.into_iter().flat_map(|shape| NOISES.map(|noise| (shape, noise))) {
        let mut found = Spec::new(shape, noise).make();
        let (before, _) = found.errors();
        let report = found.graph.optimise(&Options::default()).unwrap();
        assert!(report.converged(), "{shape:?} {noise:?}: {:?}", report.outcome);
        let mut best = Spec::new(shape, noise).make();
        for (node, truth) in best.truth.iter().enumerate() {
            best.graph.set_pose(NodeId(node as u64), *truth).unwrap();
        }
        let from_truth = best.graph.optimise(&Options::default()).unwrap();
        assert!((report.final_cost / from_truth.final_cost - 1.0).abs() < 1e-6, "{shape:?} {noise:?}");

        // With informations that are right, χ² has as many degrees of freedom as there are more numbers measured than
        // sought, and a variance of twice that.
        let freedom = 6.0 * (found.graph.edges().len() + 1 - found.graph.nodes().len()) as f64;
        let chi2 = 2.0 * report.final_cost;
        assert!((chi2 - freedom).abs() < 4.0 * (2.0 * freedom).sqrt(), "{shape:?} {noise:?}: {chi2} of {freedom}");
        let (after, _) = found.errors();
        assert!(after < 0.2 * before, "{shape:?} {noise:?}: {before} m to {after} m");
    }
}

#[test]
fn the_minimum_is_found_from_odometry_that_lost_its_way() {
    for (shape, seed) in SHAPES.into_iter().flat_map(|shape| (1..4).map(move |seed| (shape, seed))) {
        // 6 degrees a step.
        let spec = Spec { seed, ..Spec::new(shape, (0.2, 0.1)) };
        let mut found = spec.make();
        let report = found.graph.optimise(&Options::default()).unwrap();
        let mut best = spec.make();
        for (node, truth) in best.truth.iter().enumerate() {
            best.graph.set_pose(NodeId(node as u64), *truth).unwrap();
        }
        let from_truth = best.graph.optimise(&Options::default()).unwrap();
        assert!(report.converged() && (report.final_cost / from_truth.final_cost - 1.0).abs() < 1e-6, "{spec:?}");
    }
}

#[test]
fn errors_are_as_large_as_the_covariances_say() {
    for shape in SHAPES {
        let mut problem = Spec::new(shape, (0.02, 0.01)).make();
        problem.graph.optimise(&Options::default()).unwrap();
        let mut marginals = problem.graph.marginals().unwrap();
        let mut sum = 0.0;
        for (node, truth) in problem.graph.nodes().iter().zip(&problem.truth).skip(1) {
            let error = nalgebra::Vector6::from((node.world_from_node.inverse() * *truth).log());
            sum += error.dot(&marginals.node(node.id).unwrap().lu().solve(&error).unwrap());
        }
        // 6 degrees of freedom each. Errors of neighbours are nearly the same, so that the mean varies much.
        let mean = sum / (problem.truth.len() - 1) as f64;
        assert!(mean > 1.5 && mean < 18.0, "{shape:?}: {mean}");
    }
}

#[test]
fn exact_loops_undo_all_noise_of_the_guess() {
    for shape in SHAPES {
        let spec = Spec { exact_loops: true, ..Spec::new(shape, (0.05, 0.02)) };
        let mut problem = spec.make();
        // Odometry remains only as the guess.
        let guess = problem.graph.clone();
        problem.graph = PoseGraph::new();
        for node in guess.nodes() {
            problem.graph.add_node(node.id, node.world_from_node).unwrap();
            problem.graph.set_fixed(node.id, node.fixed).unwrap();
        }
        for (at, edge) in guess.edges().iter().enumerate() {
            let mut edge = edge.clone();
            let odometry = at < guess.nodes().len() - 1;
            if odometry {
                edge.from_from_to = problem.truth[at].inverse() * problem.truth[at + 1];
            }
            problem.graph.add_edge(edge).unwrap();
        }
        let report = problem.graph.optimise(&Options::default()).unwrap();
        let (_, largest) = problem.errors();
        assert!(report.converged() && largest < 1e-6 && report.final_cost < 1e-9, "{shape:?}: {largest} m, {report:?}");
    }
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let run = || {
        let mut problem = Spec::new(SHAPES[0], NOISES[1]).make();
        let report = problem.graph.optimise(&Options::default()).unwrap();
        (itm_graph::g2o::write(&problem.graph), format!("{report:?}"))
    };
    assert_eq!(run(), run());
}

#[test]
fn parts_that_nothing_holds_are_held_and_named() {
    let mut graph = row(3);
    for (id, z) in [(10, 5.0), (11, 7.0), (20, -1.0)] {
        graph.add_node(NodeId(id), ahead(z)).unwrap();
    }
    graph.add_edge(Edge::sequential(NodeId(11), NodeId(10), ahead(-1.0), information(0.1, 0.1))).unwrap();
    graph.set_fixed(NodeId(2), true).unwrap();
    graph.set_pose(NodeId(0), ahead(0.3)).unwrap();
    let report = graph.optimise(&Options::default()).unwrap();
    assert!(report.converged() && report.held == [NodeId(10), NodeId(20)], "{report:?}");
    for (id, z) in [(0, 0.0), (1, 1.0), (2, 2.0), (10, 5.0), (11, 6.0), (20, -1.0)] {
        let at = graph.pose(NodeId(id)).unwrap().translation.z;
        assert!((at - z).abs() < 1e-6, "node {id} is at {at}");
    }
}

#[test]
fn little_or_nothing_to_do_is_done() {
    for nodes in 0..3 {
        let mut graph = row(nodes);
        let report = graph.optimise(&Options::default()).unwrap();
        assert!(report.converged() && graph == row(nodes), "{nodes} nodes: {report:?}");
    }
    // Edges that say nothing pull nowhere.
    let mut graph = row(1);
    graph.add_node(NodeId(7), ahead(3.0)).unwrap();
    graph.add_edge(Edge::sequential(NodeId(0), NodeId(7), ahead(1.0), nalgebra::Matrix6::zeros())).unwrap();
    let before = graph.clone();
    assert!(graph.optimise(&Options::default()).unwrap().converged() && graph == before);
}

#[test]
fn what_an_edge_leaves_open_stays_as_it_was() {
    let mut graph = row(1);
    let guess = Se3::exp([0.0, 0.0, 2.0, 0.0, 0.0, 0.3]);
    graph.add_node(NodeId(1), guess).unwrap();
    let mut only_z = nalgebra::Matrix6::zeros();
    only_z[(2, 2)] = 100.0;
    graph.add_edge(Edge::sequential(NodeId(0), NodeId(1), ahead(1.0), only_z)).unwrap();
    let report = graph.optimise(&Options::default()).unwrap();
    let pose = graph.pose(NodeId(1)).unwrap();
    assert!(report.converged() && (pose.translation.z - 1.0).abs() < 1e-6, "{report:?} {pose:?}");
    assert!(pose.translation.x.abs() < 1e-6 && pose.rotation.angle_between(guess.rotation) < 1e-6);
}

#[test]
fn a_run_that_was_cut_short_goes_on() {
    let mut problem = Spec::new(SHAPES[1], NOISES[1]).make();
    let short = Options { max_iterations: 2, ..Options::default() };
    let first = problem.graph.optimise(&short).unwrap();
    assert_eq!((first.outcome, first.iterations), (Outcome::IterationLimit, 2));
    assert!(first.final_cost < first.initial_cost && problem.graph.cost() == first.final_cost);
    assert!(problem.graph.optimise(&Options::default()).unwrap().converged());
}
