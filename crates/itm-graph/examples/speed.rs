//! How long optimising takes on the standard problems, as the median of some runs:
//! `cargo run --release -p itm-graph --example speed`. With the name of a folder behind `--` it also writes them there as
//! g2o's text, for other solvers.

#![allow(clippy::print_stdout, reason = "a program")]

#[path = "../tests/graphs/problems.rs"]
mod problems;

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use itm_graph::{Edge, Kernel, Options, g2o};
use problems::{Shape, Spec};

const RUNS: usize = 15;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).map(PathBuf::from);
    let scaling = Kernel::DynamicScaling { phi: Edge::CLOSURE_PHI };
    let small = (0.1, 0.05);
    let large = (0.02, 0.01);
    for (name, spec) in [
        ("sphere", Spec::new(Shape::Sphere { laps: 6, lap: 6 }, small)),
        ("torus", Spec::new(Shape::Torus { windings: 6, winding: 6 }, small)),
        ("grid", Spec { false_share: 0.1, ..Spec::new(Shape::Grid { nodes: 40 }, small) }),
        ("sphere-1024", Spec::new(Shape::Sphere { laps: 32, lap: 32 }, large)),
        ("torus-1024", Spec::new(Shape::Torus { windings: 32, winding: 32 }, large)),
        ("grid-1000", Spec::new(Shape::Grid { nodes: 1000 }, large)),
        (
            "sphere-1024-false",
            Spec { false_share: 0.05, kernel: scaling, ..Spec::new(Shape::Sphere { laps: 32, lap: 32 }, large) },
        ),
    ] {
        let mut problem = spec.make();
        let start = problem.graph.clone();
        if let Some(folder) = &folder {
            std::fs::write(folder.join(format!("{name}.g2o")), g2o::write(&start))?;
        }
        let report = problem.graph.optimise(&Options::default())?;
        let mut times = Vec::new();
        for _ in 0..RUNS {
            let mut graph = start.clone();
            let clock = Instant::now();
            graph.optimise(&Options::default())?;
            times.push(1e3 * clock.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        let (median, fastest) = (times[RUNS / 2], times[0]);
        let (nodes, edges) = (problem.graph.nodes().len(), problem.graph.edges().len());
        let (denied, lies) = (
            report.edges[problem.true_edges..].iter().filter(|edge| edge.weight < 0.1).count(),
            edges - problem.true_edges,
        );
        let (off, _) = problem.errors();
        let (outcome, iterations) = (report.outcome, report.iterations);
        println!(
            "{median:7.1} ms (fastest {fastest:.1})  {name}: {nodes} nodes, {edges} edges, {outcome:?} after {iterations} iterations, {off:.3} m off, {denied} of {lies} false closures denied"
        );
    }
    Ok(())
}
