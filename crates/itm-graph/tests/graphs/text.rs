//! g2o's text.

use itm_core::Se3;
use itm_graph::{EdgeKind, Kernel, NodeId, Options, PoseGraph, g2o};
use nalgebra::Vector6;

use crate::problems::{Shape, Spec};

fn read(text: &str) -> Result<PoseGraph, String> {
    g2o::read(text, "graph.g2o").map_err(|e| e.to_string())
}

#[test]
fn what_is_written_reads_back_with_the_same_bits() {
    let mut problem = Spec::new(Shape::Grid { nodes: 50 }, (0.1, 0.1)).make();
    problem.graph.optimise(&Options::default()).unwrap();
    let text = g2o::write(&problem.graph);
    let back = read(&text).unwrap();
    assert_eq!(g2o::write(&back), text);
    assert_eq!(back.nodes(), problem.graph.nodes());
    assert_eq!(back.edges(), problem.graph.edges(), "the walk's edges have no kernels");
    assert_eq!(back.cost().to_bits(), problem.graph.cost().to_bits());
}

#[test]
fn files_of_others_are_read() {
    let text = "\u{feff}# a comment\r\nEDGE_SE3:QUAT 5 7 1 2 3 0 0 0 -1.002 \
                1 0 0 0 0 0 2 0 0 0 0 3 0 0 0 4 0 0 8 0 12\r\n\r\n\
                VERTEX_SE3:QUAT 5 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 7 1e0 2 +3 0 0 0.6 0.8\nFIX 5 7\n";
    let graph = read(text).unwrap();
    assert!(graph.nodes().iter().all(|node| node.fixed));
    let edge = &graph.edges()[0];
    assert_eq!((edge.from, edge.to, edge.kind, edge.kernel), (NodeId(5), NodeId(7), EdgeKind::Loop, Kernel::None));
    // Of the rotation vector, which is twice the quaternion's part.
    assert_eq!(edge.information.diagonal(), Vector6::new(1.0, 2.0, 3.0, 1.0, 2.0, 3.0));
}

#[test]
fn costs_are_those_of_quaternions_where_residuals_are_small() {
    let text = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n\
                VERTEX_SE3:QUAT 1 0.002 0 0 0.001 0 0 0.9999995\n\
                EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 50 0 0 50 0 50\n";
    // (t, q_vec) = (0.002, 0, 0, 0.001, 0, 0).
    let expected = 0.5 * (10.0 * 4e-6 + 50.0 * 1e-6);
    assert!((read(text).unwrap().cost() / expected - 1.0).abs() < 1e-6);
}

#[test]
fn planar_graphs_are_read_and_stay_planar() {
    let text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1.1 0 1.4\nVERTEX_SE2 2 1.2 0.9 3.0\n\
                EDGE_SE2 0 1 1 0 1.57 100 0 0 100 0 400\n\
                EDGE_SE2 1 2 1 0 1.57 100 0 0 100 0 400\n\
                EDGE_SE2 2 0 1 1.1 3.0 50 10 0 60 5 300\nFIX 0\n";
    let mut graph = read(text).unwrap();
    let report = graph.optimise(&Options::default()).unwrap();
    assert!(report.converged() && report.final_cost < 20.0);
    for node in graph.nodes() {
        let Se3 { rotation: q, translation: t } = node.world_from_node;
        assert!(t.z.abs() < 1e-12 && q.x.abs() < 1e-12 && q.y.abs() < 1e-12, "{node:?}");
    }
    let corner = graph.pose(NodeId(2)).unwrap().translation;
    assert!((corner.x - 1.0).abs() < 0.2 && (corner.y - 1.0).abs() < 0.2, "{corner}");
    assert!((graph.edges()[0].from_from_to.log()[5] - 1.57).abs() < 1e-12);
}

#[test]
fn bad_lines_are_refused_with_their_number() {
    let identity = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
    for (line, expected) in [
        ("VERTEX_XYZ 3 0 0 0", "found 'VERTEX_XYZ'"),
        ("VERTEX_SE3:QUAT 3 0 0 0 0 0 0", "expected an id and 7 numbers after VERTEX_SE3:QUAT, found 7 values"),
        ("VERTEX_SE3:QUAT -3 0 0 0 0 0 0 1", "a whole number from 0, found '-3'"),
        ("VERTEX_SE3:QUAT 3 0 0,5 0 0 0 0 1", "expected a finite number, found '0,5'"),
        ("VERTEX_SE3:QUAT 3 0 nan 0 0 0 0 1", "found 'nan'"),
        ("VERTEX_SE3:QUAT 3 0 0 0 0 0 0 2", "unit length"),
        ("VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1", "already has a node 1"),
        ("VERTEX_SE2 3 0 0", "3 numbers"),
        ("FIX 8", "no node 8"),
        ("FIX one", "found 'one'"),
        (&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 {identity} 1"), "found 31 values"),
        (&format!("EDGE_SE3:QUAT 0 2 0 0 0 0 0 0 1 {identity}"), "no node 2"),
        (&format!("EDGE_SE3:QUAT 1 1 0 0 0 0 0 0 1 {identity}"), "itself"),
        (&format!("EDGE_SE3:QUAT 9 0 0 0 0 0 0 0 1 {identity}"), "from node 9 to node 0 has no node 9 to end at"),
        (&format!("EDGE_SE3:QUAT 0 1 0 NaN 0 0 0 0 1 {identity}"), "expected a finite number, found 'NaN'"),
        (&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 inf {identity}"), "expected a finite number, found 'inf'"),
        (&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 0 {identity}"), "unit length"),
        (&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 nan{}", &identity[1..]), "expected a finite number, found 'nan'"),
        (&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 1e101{}", &identity[1..]), "finite numbers up to 1e100"),
        (&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 -{identity}"), "semidefinite"),
        ("EDGE_SE2 0 7 0 0 0 1 0 0 1 0 1", "from node 0 to node 7 has no node 7 to end at"),
        ("EDGE_SE2 0 1 0 0 nan 1 0 0 1 0 1", "expected a finite number, found 'nan'"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0 -1", "semidefinite"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0", "9 numbers"),
    ] {
        let text = format!("# graph\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n{line}\n");
        let error = read(&text).unwrap_err();
        assert!(error.contains("'graph.g2o', line 4") && error.contains(expected), "{error}");
    }
    assert_eq!(read("").unwrap(), PoseGraph::new());
}
