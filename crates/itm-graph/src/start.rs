//! Where to start from, if not from where the nodes are thought to be.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use itm_core::Se3;

use crate::{Kernel, PoseGraph};

/// Poses by the measurements along the shortest ways from what is fixed or `held`, where these and edges that are
/// believed reach all nodes.
///
/// What makes many iterations necessary are errors of rotation that add up along the way, as those of odometry do. So a
/// way is as long as its rotations' variances together (Dijkstra 1959). An edge with a robust kernel may be false, and one
/// of incomplete information says too little: neither is gone along.
pub(crate) fn along_shortest_ways(graph: &PoseGraph, held: &[usize]) -> Option<Vec<Se3>> {
    let mut poses = graph.poses();
    // For each node the edges at it, with their lengths and other ends.
    let mut edges_at = vec![Vec::new(); poses.len()];
    for (at, (edge, [from, to])) in graph.edges().iter().zip(graph.ends()).enumerate() {
        if edge.kernel == Kernel::None && edge.information.cholesky().is_some() {
            let variance: f64 = edge.information.diagonal().iter().skip(3).map(|rotation| rotation.recip()).sum();
            edges_at[*from].push((at, variance, *to));
            edges_at[*to].push((at, variance, *from));
        }
    }
    let mut length = vec![f64::INFINITY; poses.len()];
    let mut open: BinaryHeap<(Reverse<u64>, usize, Option<usize>)> = BinaryHeap::new();
    let fixed = graph.nodes().iter().enumerate().filter(|(_, node)| node.fixed).map(|(node, _)| node);
    for root in fixed.chain(held.iter().copied()) {
        length[root] = 0.0;
        open.push((Reverse(0), root, None));
    }
    let mut is_reached = vec![false; poses.len()];
    while let Some((_, node, by)) = open.pop() {
        if is_reached[node] {
            continue;
        }
        is_reached[node] = true;
        if let Some(edge) = by {
            let [from, to] = graph.ends()[edge];
            let from_from_to = graph.edges()[edge].from_from_to;
            poses[node] = if node == to { poses[from] * from_from_to } else { poses[to] * from_from_to.inverse() };
        }
        for &(edge, variance, other) in &edges_at[node] {
            let longer = length[node] + variance;
            if longer < length[other] {
                length[other] = longer;
                // The bits of numbers that are not negative are in the order of the numbers.
                open.push((Reverse(longer.to_bits()), other, Some(edge)));
            }
        }
    }
    is_reached.iter().all(|reached| *reached).then_some(poses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Edge, NodeId, information};

    fn ahead(z: f64) -> Se3 {
        Se3::exp([0.0, 0.0, z, 0.0, 0.0, 0.0])
    }

    /// Three nodes at zero, the first held, an edge to each next one and one from the first to the last.
    fn triangle(last: Edge) -> (PoseGraph, Option<Vec<f64>>) {
        let mut graph = PoseGraph::new();
        for id in 0..3 {
            graph.add_node(NodeId(id), Se3::IDENTITY).unwrap();
        }
        for id in 0..2 {
            let step = Edge::sequential(NodeId(id), NodeId(id + 1), ahead(1.0), information(0.01, 0.01));
            graph.add_edge(step).unwrap();
        }
        graph.add_edge(last).unwrap();
        let poses = along_shortest_ways(&graph, &[0]);
        let z = poses.map(|poses| poses.iter().map(|pose| pose.translation.z).collect());
        (graph, z)
    }

    fn shortcut(rotation: f64) -> Edge {
        // Given the other way around.
        Edge::sequential(NodeId(2), NodeId(0), ahead(-5.0), information(0.01, rotation))
    }

    #[test]
    fn the_way_of_the_least_rotation_is_gone() {
        // Variances add up: two steps of 0.01 are as long as one of 0.0141.
        assert_eq!(triangle(shortcut(0.0142)).1.unwrap(), [0.0, 1.0, 2.0]);
        assert_eq!(triangle(shortcut(0.0141)).1.unwrap(), [0.0, 1.0, 5.0]);
    }

    #[test]
    fn what_may_be_false_or_says_too_little_is_not_followed() {
        let scaled = Edge { kernel: Kernel::DynamicScaling { phi: 1.0 }, ..shortcut(0.001) };
        assert_eq!(triangle(scaled.clone()).1.unwrap(), [0.0, 1.0, 2.0]);
        let mut partial = shortcut(0.001);
        partial.information[(0, 0)] = 0.0;
        assert_eq!(triangle(partial).1.unwrap(), [0.0, 1.0, 2.0]);
        // Where nothing else leads to a node, poses stay as they are.
        let (mut graph, _) = triangle(scaled);
        graph.add_node(NodeId(3), Se3::IDENTITY).unwrap();
        let closure = Edge::closure(NodeId(0), NodeId(3), ahead(1.0), information(0.01, 0.01));
        graph.add_edge(closure).unwrap();
        assert!(along_shortest_ways(&graph, &[0]).is_none());
    }

    #[test]
    fn ways_begin_at_all_that_is_fixed() {
        let (mut graph, _) = triangle(shortcut(1.0));
        graph.set_pose(NodeId(2), ahead(3.0)).unwrap();
        graph.set_fixed(NodeId(2), true).unwrap();
        let poses = along_shortest_ways(&graph, &[]).unwrap();
        assert_eq!(poses.iter().map(|pose| pose.translation.z).collect::<Vec<_>>(), [1.0, 2.0, 3.0]);
    }
}
