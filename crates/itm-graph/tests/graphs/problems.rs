//! The standard problems of pose graphs, with known truth: a spiral on a sphere (as the sphere of Kümmerle et al. 2011),
//! a coil on a torus, and a walk on a grid with right-angled turns, after the Manhattan worlds of Olson et al. 2006, in
//! three dimensions.

#![allow(clippy::unwrap_used, reason = "all of a problem is made here, so that no graph can refuse it")]

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DQuat, DVec3, IVec3};
use itm_core::Se3;
use itm_graph::{Edge, Kernel, NodeId, PoseGraph, information};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// Laps around the axis from pole to pole, on a sphere of 10 m radius.
    Sphere { laps: usize, lap: usize },
    /// Windings of a coil once around a torus of 10 m and 3 m radius.
    Torus { windings: usize, winding: usize },
    /// Steps of a metre on a grid.
    Grid { nodes: usize },
}

/// What to make. Node 0 is fixed at its true pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spec {
    pub(crate) shape: Shape,
    /// Standard deviations of each measurement in each direction, in metres and radians.
    pub(crate) noise: (f64, f64),
    /// Whether loops, unlike odometry, are measured without noise.
    pub(crate) exact_loops: bool,
    /// Loop closures between random nodes with random measurements, as a share of the true ones.
    pub(crate) false_share: f64,
    /// For all loop closures, true and false.
    pub(crate) kernel: Kernel,
    pub(crate) seed: u64,
}

impl Spec {
    pub(crate) fn new(shape: Shape, noise: (f64, f64)) -> Self {
        Self { shape, noise, exact_loops: false, false_share: 0.0, kernel: Kernel::None, seed: 1 }
    }

    pub(crate) fn make(&self) -> Problem {
        let mut random = Random(Pcg64Mcg::seed_from_u64(self.seed));
        let (truth, loops) = match self.shape {
            Shape::Sphere { laps, lap } => (sphere(laps, lap), neighbours(laps, lap, false)),
            Shape::Torus { windings, winding } => (torus(windings, winding), neighbours(windings, winding, true)),
            Shape::Grid { nodes } => grid(nodes, &mut random),
        };
        let mut graph = PoseGraph::new();
        let id = |node: usize| NodeId(node as u64);
        let weight = information(self.noise.0, self.noise.1);
        let mut guess = truth[0];
        graph.add_node(id(0), guess).unwrap();
        graph.set_fixed(id(0), true).unwrap();
        for node in 1..truth.len() {
            let measured = truth[node - 1].inverse() * truth[node] * random.motion(self.noise);
            guess = guess * measured;
            graph.add_node(id(node), guess).unwrap();
            graph.add_edge(Edge::sequential(id(node - 1), id(node), measured, weight)).unwrap();
        }
        let closure = |a: usize, b: usize, measured| Edge {
            kernel: self.kernel,
            ..Edge::closure(id(a), id(b), measured, weight)
        };
        for [a, b] in &loops {
            let error = if self.exact_loops { Se3::IDENTITY } else { random.motion(self.noise) };
            graph.add_edge(closure(*a, *b, truth[*a].inverse() * truth[*b] * error)).unwrap();
        }
        let true_edges = graph.edges().len();
        for _ in 0..(self.false_share * loops.len() as f64).round() as usize {
            let (a, b) = random.pair(truth.len());
            graph.add_edge(closure(a, b, random.motion((1.0, 0.5)))).unwrap();
        }
        Problem { graph, truth, true_edges }
    }
}

pub(crate) struct Problem {
    pub(crate) graph: PoseGraph,
    /// True poses of the nodes, in their order.
    pub(crate) truth: Vec<Se3>,
    /// Edges from here on are false closures.
    pub(crate) true_edges: usize,
}

impl Problem {
    /// Root mean square and largest distance in metres of the nodes from the truth.
    pub(crate) fn errors(&self) -> (f64, f64) {
        let distances = self.graph.nodes().iter().zip(&self.truth);
        let squares: Vec<f64> =
            distances.map(|(n, t)| n.world_from_node.translation.distance_squared(t.translation)).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        (mean.sqrt(), squares.iter().copied().fold(0.0, f64::max).sqrt())
    }
}

struct Random(Pcg64Mcg);

impl Random {
    /// Normally distributed with standard deviation 1 (Box and Muller 1958).
    fn gaussian(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.0.random::<f64>()).ln()).sqrt();
        radius * (TAU * self.0.random::<f64>()).cos()
    }

    fn motion(&mut self, (translation_m, rotation_rad): (f64, f64)) -> Se3 {
        let sigma = |i| if i < 3 { translation_m } else { rotation_rad };
        Se3::exp(std::array::from_fn(|i| sigma(i) * self.gaussian()))
    }

    /// Two nodes that do not follow each other.
    fn pair(&mut self, nodes: usize) -> (usize, usize) {
        loop {
            let (a, b) = (self.0.random_range(0..nodes), self.0.random_range(0..nodes));
            if a + 1 < b {
                return (a, b);
            }
        }
    }
}

/// Looking along the way, z up from the surface.
fn sphere(laps: usize, lap: usize) -> Vec<Se3> {
    let nodes = laps * lap;
    let pose = |i: usize| {
        let longitude = TAU * i as f64 / lap as f64;
        // Not quite from pole to pole, where laps would have no length.
        let latitude = 0.9 * PI * ((i as f64 + 0.5) / nodes as f64 - 0.5);
        let rotation = DQuat::from_rotation_z(longitude) * DQuat::from_rotation_y(FRAC_PI_2 - latitude);
        Se3::new(rotation, rotation * DVec3::new(0.0, 0.0, 10.0))
    };
    (0..nodes).map(pose).collect()
}

fn torus(windings: usize, winding: usize) -> Vec<Se3> {
    let nodes = windings * winding;
    let pose = |i: usize| {
        let around = DQuat::from_rotation_z(TAU * i as f64 / nodes as f64);
        let tube = DQuat::from_rotation_y(TAU * i as f64 / winding as f64);
        Se3::new(around * tube, around * (DVec3::new(10.0, 0.0, 0.0) + tube * DVec3::new(3.0, 0.0, 0.0)))
    };
    (0..nodes).map(pose).collect()
}

/// Each node with those beside it one lap later; on a closed surface the last lap with the first.
fn neighbours(laps: usize, lap: usize, closed: bool) -> Vec<[usize; 2]> {
    let nodes = laps * lap;
    let mut pairs = Vec::new();
    for i in 0..nodes {
        for j in [i + lap - 1, i + lap, i + lap + 1] {
            if j < nodes {
                pairs.push([i, j]);
            } else if closed {
                pairs.push([j - nodes, i]);
            }
        }
    }
    pairs.retain(|[a, b]| a + 1 < *b);
    pairs
}

/// A walk in a box of 6 m, and each node with the last one before it at each place a step away.
fn grid(nodes: usize, random: &mut Random) -> (Vec<Se3>, Vec<[usize; 2]>) {
    let axes = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];
    let (mut place, mut ahead) = (IVec3::ZERO, IVec3::X);
    let mut last_at = BTreeMap::new();
    let (mut truth, mut loops) = (Vec::new(), Vec::new());
    for node in 0..nodes {
        truth.push(Se3::new(DQuat::from_rotation_arc(DVec3::X, ahead.as_dvec3()), place.as_dvec3()));
        let near = axes.iter().chain([&IVec3::ZERO]).filter_map(|step| last_at.get(&(place + step).to_array()));
        loops.extend(near.filter(|last| **last + 1 < node).map(|last| [*last, node]));
        last_at.insert(place.to_array(), node);
        loop {
            // Straight on more often than not, and never straight back.
            let next = if random.0.random_bool(0.6) { ahead } else { axes[random.0.random_range(0..axes.len())] };
            if next != -ahead && (place + next).abs().max_element() <= 3 {
                (place, ahead) = (place + next, next);
                break;
            }
            ahead = axes[random.0.random_range(0..axes.len())];
        }
    }
    (truth, loops)
}
