//! The same minimum as another solver finds.
//!
//! `tests/data` holds small problems, which the example `speed` writes, and the costs that scipy reaches on them.

use std::path::PathBuf;

use itm_graph::{Edge, EdgeKind, Kernel, Options, PoseGraph, g2o};

fn data(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "data", name].iter().collect()
}

#[test]
fn costs_are_those_of_scipy() {
    let costs = std::fs::read_to_string(data("costs.txt")).unwrap();
    let mut compared = 0;
    for row in costs.lines().filter(|line| !line.starts_with('#')) {
        let [name, phi, expected] = row.split(' ').collect::<Vec<_>>()[..] else { panic!("{row}") };
        let read = g2o::read(&std::fs::read_to_string(data(name)).unwrap(), name).unwrap();
        let kernel = phi.parse().map_or(Kernel::None, |phi| Kernel::DynamicScaling { phi });
        let mut graph = PoseGraph::new();
        for node in read.nodes() {
            graph.add_node(node.id, node.world_from_node).unwrap();
            graph.set_fixed(node.id, node.fixed).unwrap();
        }
        for edge in read.edges() {
            let kernel = if edge.kind == EdgeKind::Loop { kernel } else { Kernel::None };
            graph.add_edge(Edge { kernel, ..edge.clone() }).unwrap();
        }
        let report = graph.optimise(&Options::default()).unwrap();
        let expected: f64 = expected.parse().unwrap();
        assert!((report.final_cost / expected - 1.0).abs() < 1e-6, "{name}: {} is not {expected}", report.final_cost);
        compared += 1;
    }
    assert_eq!(compared, 4);
}
