//! Pose graphs over SE(3): where the parts of a map lie, from what was measured between them.
//!
//! A [`PoseGraph`] has [`Node`]s (a submap, a keyframe) with a pose each, and [`Edge`]s that say how one was measured
//! from another. [`PoseGraph::optimise`] moves the nodes to where all edges agree best, by Levenberg-Marquardt on
//! sparse normal equations, after Kümmerle et al. 2011 (*g2o: A General Framework for Graph Optimization*) and Grisetti
//! et al. 2010 (*A Tutorial on Graph-Based SLAM*). Robust [`Kernel`]s keep one false loop closure from bending the map,
//! and the [`Report`] names it. [`PoseGraph::marginals`] says how well poses are known relative to each other, so that a
//! closure can be tested before it is believed. [`g2o`] reads and writes the text that other solvers share.
//!
//! # What is minimised
//! An edge from `a` to `b` with the measurement `a_from_b` has the residual
//! ```text
//! e = log(measured_a_from_b⁻¹ * world_from_a⁻¹ * world_from_b)
//! ```
//! a twist `(v, ω)` as of [`itm_core::Se3::log`]: translation in metres first, then the rotation vector in radians. With
//! its information matrix `Ω` (in the same order) `χ² = eᵀ Ω e`, and the cost of a graph is `½ Σ ρ(χ²)` over its edges,
//! `ρ` being the edge's kernel.
//!
//! ```
//! use itm_core::Se3;
//! use itm_graph::{Edge, NodeId, Options, PoseGraph, information};
//!
//! let metre_ahead = Se3::exp([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
//! let mut graph = PoseGraph::new();
//! graph.add_node(NodeId(0), Se3::IDENTITY)?;
//! graph.add_node(NodeId(1), metre_ahead * metre_ahead)?;
//! graph.add_edge(Edge::sequential(NodeId(0), NodeId(1), metre_ahead, information(0.01, 0.005)))?;
//! let report = graph.optimise(&Options::default())?;
//! assert!(report.converged() && report.final_cost < 1e-12);
//! assert!((graph.pose(NodeId(1))?.translation.z - 1.0).abs() < 1e-9);
//! # Ok::<(), itm_graph::Error>(())
//! ```

mod edge;
mod error;
mod factor;
pub mod g2o;
mod graph;
mod kernel;
mod marginals;
mod optimise;
mod order;
mod parts;
mod sparse;
mod start;
mod system;
mod tangent;

pub use edge::{Edge, EdgeKind, information};
pub use error::Error;
pub use graph::{Node, NodeId, PoseGraph};
pub use kernel::Kernel;
pub use marginals::Marginals;
pub use optimise::{EdgeReport, Options, Outcome, Report};
