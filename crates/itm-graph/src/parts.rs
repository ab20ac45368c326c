//! Which nodes hang together, and what holds them.

use crate::PoseGraph;

/// Each node's part of the graph, as the place of the part's first node: nodes that a chain of edges joins have the
/// same. By union-find (Galler and Fischer 1964).
pub(crate) fn parts(graph: &PoseGraph) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..graph.nodes().len()).collect();
    for &[a, b] in graph.ends() {
        let (a, b) = (root(&mut parent, a), root(&mut parent, b));
        // The first node of each part stays its root.
        parent[a.max(b)] = a.min(b);
    }
    (0..parent.len()).map(|node| root(&mut parent, node)).collect()
}

fn root(parent: &mut [usize], mut node: usize) -> usize {
    while parent[node] != node {
        parent[node] = parent[parent[node]];
        node = parent[node];
    }
    node
}

/// The first node of each part that has no fixed one, by place: what optimising holds, so that nothing floats.
pub(crate) fn held(graph: &PoseGraph, parts: &[usize]) -> Vec<usize> {
    let mut is_held: Vec<bool> = parts.iter().enumerate().map(|(node, part)| node == *part).collect();
    for (node, part) in graph.nodes().iter().zip(parts) {
        is_held[*part] &= !node.fixed;
    }
    (0..parts.len()).filter(|node| is_held[*node]).collect()
}
