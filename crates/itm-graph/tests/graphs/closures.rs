//! False loop closures.

use itm_graph::{Edge, EdgeKind, Kernel, Options};

use crate::problems::{Shape, Spec};

const NOISE: (f64, f64) = (0.05, 0.01);
const SCALING: Kernel = Kernel::DynamicScaling { phi: Edge::CLOSURE_PHI };

#[test]
fn false_closures_bend_a_map_only_without_scaling() {
    for shape in [Shape::Sphere { laps: 16, lap: 16 }, Shape::Grid { nodes: 250 }] {
        let error_of = |false_share, kernel| {
            let mut problem = Spec { false_share, kernel, ..Spec::new(shape, NOISE) }.make();
            problem.graph.optimise(&Options::default()).unwrap();
            problem.errors().0
        };
        let clean = error_of(0.0, Kernel::None);
        for share in [0.01, 0.05, 0.2] {
            let (believed, scaled) = (error_of(share, Kernel::None), error_of(share, SCALING));
            assert!(scaled < 1.05 * clean, "{shape:?}, {share}: {scaled} m, without false closures {clean} m");
            assert!(believed > 4.0 * clean, "{shape:?}, {share}: {believed} m, without false closures {clean} m");
        }
    }
}

#[test]
fn a_report_names_false_closures() {
    let shape = Shape::Torus { windings: 15, winding: 15 };
    let mut problem = Spec { false_share: 0.05, kernel: SCALING, ..Spec::new(shape, NOISE) }.make();
    let report = problem.graph.optimise(&Options::default()).unwrap();
    let (believed, denied) = report.edges.split_at(problem.true_edges);
    assert!(!denied.is_empty() && denied.iter().all(|edge| edge.weight < 0.1 && edge.kind == EdgeKind::Loop));
    assert!(believed.iter().all(|edge| edge.weight > 0.1 && edge.chi2 < 60.0));

    // Without them, the graph is where it was with them.
    let with_them = problem.errors().0;
    let mut weights = report.edges.iter().map(|edge| edge.weight);
    problem.graph.retain_edges(|_| weights.next().is_some_and(|weight| weight > 0.1));
    assert_eq!(problem.graph.edges().len(), problem.true_edges);
    let again = problem.graph.optimise(&Options::default()).unwrap();
    assert!(again.converged() && (problem.errors().0 / with_them - 1.0).abs() < 0.01);
    assert!(again.edges.iter().zip(problem.graph.edges()).all(|(r, e)| (r.from, r.to) == (e.from, e.to)));
}

#[test]
fn other_kernels_soften_false_closures() {
    let shape = Shape::Grid { nodes: 250 };
    let error_of = |kernel| {
        let mut problem = Spec { false_share: 0.02, kernel, ..Spec::new(shape, NOISE) }.make();
        problem.graph.optimise(&Options::default()).unwrap();
        problem.errors().0
    };
    let believed = error_of(Kernel::None);
    for kernel in [Kernel::Huber(4.0), Kernel::Cauchy(4.0)] {
        assert!(error_of(kernel) < 0.5 * believed, "{kernel:?}");
    }
}
