//! How long optimising takes on the standard problems: `cargo run --release -p itm-graph --example speed`.
#![allow(clippy::print_stdout)] // a program

#[path = "../tests/graphs/problems.rs"]
mod problems;

use std::time::Instant;

use itm_graph::{Edge, Kernel, Options};
use problems::{Shape, Spec};

fn main() -> Result<(), itm_graph::Error> {
    let scaling = Kernel::DynamicScaling { phi: Edge::CLOSURE_PHI };
    for (shape, false_share, kernel) in [
        (Shape::Sphere { laps: 32, lap: 32 }, 0.0, Kernel::None),
        (Shape::Sphere { laps: 32, lap: 32 }, 0.05, scaling),
        (Shape::Torus { windings: 32, winding: 32 }, 0.0, Kernel::None),
        (Shape::Grid { nodes: 1000 }, 0.0, Kernel::None),
    ] {
        let spec = Spec { false_share, kernel, ..Spec::new(shape, (0.02, 0.01)) };
        let (mut fastest, mut line) = (f64::INFINITY, String::new());
        for _ in 0..5 {
            let mut problem = spec.make();
            let (nodes, edges) = (problem.graph.nodes().len(), problem.graph.edges().len());
            let start = Instant::now();
            let report = problem.graph.optimise(&Options::default())?;
            fastest = fastest.min(1e3 * start.elapsed().as_secs_f64());
            let denied = report.edges[problem.true_edges..].iter().filter(|edge| edge.weight < 0.1).count();
            line = format!(
                "{nodes} nodes, {edges} edges, {denied} of {} false closures denied, {:?} after {} iterations, {:.3} m off",
                edges - problem.true_edges,
                report.outcome,
                report.iterations,
                problem.errors().0
            );
        }
        println!("{fastest:7.1} ms  {shape:?}: {line}");
    }
    Ok(())
}
