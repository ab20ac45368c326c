//! Graphs as g2o's text, which other solvers read and write too.
//!
//! What is understood: `VERTEX_SE3:QUAT id x y z qx qy qz qw`, `EDGE_SE3:QUAT from to x y z qx qy qz qw` with the 21
//! numbers of the information's upper triangle, `FIX id...`, and planar graphs: `VERTEX_SE2 id x y θ` and
//! `EDGE_SE2 from to x y θ` with 6 numbers. Lines that start with `#` are comments. Any other tag is an error, so that
//! nothing of a graph is left out in silence.
//!
//! # Units of the information
//! g2o's residual of `EDGE_SE3:QUAT` is a translation and the vector part of a unit quaternion (Kümmerle et al. 2011),
//! which is *half* the rotation vector where rotations are small. An [`Edge`]'s information is that of the rotation
//! vector itself. So with `D = diag(1, 1, 1, ½, ½, ½)` an information `Ω` in the text is `D Ω D` in the graph, and writing
//! does the reverse. Both are exact. Costs then agree with g2o's `½ χ²` up to terms of second order in the residual
//! (g2o's own figure has no `½`), and those of solvers that take the matrix in the text to be that of a rotation vector do
//! not: such files have their rotations' information multiplied by 4 first.
//!
//! The text holds neither kernels nor kinds: edges read have [`Kernel::None`], and are [`EdgeKind::Sequential`] where the
//! ids of their nodes follow each other, [`EdgeKind::Loop`] otherwise.
//!
//! # Planar graphs
//! A planar pose becomes one in the plane z = 0, turned about z. `EDGE_SE2`'s residual has the angle itself, so that no
//! factor is due. The directions that a planar edge says nothing about (z, and rotations about x and y) get the mean
//! information of its translations and that of its rotation, uncorrelated. In a graph that is planar nothing pulls out
//! of the plane, so that these numbers change neither poses nor cost.

use std::fmt::Write as _;

use glam::{DQuat, DVec3};
use itm_core::Se3;
use nalgebra::Matrix6;

use crate::{Edge, EdgeKind, Error, Kernel, NodeId, PoseGraph};

/// Numbers of a 3D pose, and of the upper triangle of a 6x6 matrix.
const POSE_NUMBERS: usize = 7;
const INFORMATION_NUMBERS: usize = 21;

/// Reads a graph from g2o's text. `name` is what errors call it: the file's.
///
/// A quaternion up to 1 % away from unit length, as of printed digits, is normalised.
///
/// # Errors
/// [`Error::Line`] for a line that is no such text, [`Error::Content`] for one that the graph refuses; both with name and
/// line number.
pub fn read(text: &str, name: &str) -> Result<PoseGraph, Error> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = (1..).zip(text.lines().map(str::trim)).filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let mut graph = PoseGraph::new();
    // Vertices may follow the edges that need them.
    let mut later = Vec::new();
    for (number, line) in lines {
        let mut fields = line.split_ascii_whitespace();
        let tag = fields.next().unwrap_or_default();
        let mut line = Line { name, number, tag, fields: fields.collect() };
        match tag {
            "VERTEX_SE3:QUAT" | "VERTEX_SE2" => {
                let (id, pose) = line.vertex()?;
                graph.add_node(id, pose).map_err(|reason| line.content(reason))?;
            }
            "EDGE_SE3:QUAT" | "EDGE_SE2" | "FIX" => later.push(line),
            _ => {
                line.fields = vec![tag];
                let known = "VERTEX_SE3:QUAT, EDGE_SE3:QUAT, VERTEX_SE2, EDGE_SE2 or FIX";
                return Err(line.unexpected(known, 0));
            }
        }
    }
    for line in &later {
        if line.tag == "FIX" {
            for at in 0..line.fields.len() {
                graph.set_fixed(line.id(at)?, true).map_err(|reason| line.content(reason))?;
            }
        } else {
            graph.add_edge(line.edge()?).map_err(|reason| line.content(reason))?;
        }
    }
    Ok(graph)
}

/// Writes a graph as g2o's text, vertices and fixed ones first. Kernels and kinds are not part of it.
///
/// Numbers have as many digits as they need: reading gives the same bits.
pub fn write(graph: &PoseGraph) -> String {
    let mut text = String::new();
    let mut line = |tag: &str, ids: &[NodeId], numbers: &[f64]| {
        let mut written = write!(text, "{tag}");
        for id in ids {
            written = written.and_then(|()| write!(text, " {id}"));
        }
        for number in numbers {
            // Debug, unlike Display, prints tiny numbers with an exponent.
            written = written.and_then(|()| write!(text, " {number:?}"));
        }
        written.expect("a String takes whatever is written to it");
        text.push('\n');
    };
    for node in graph.nodes() {
        line("VERTEX_SE3:QUAT", &[node.id], &pose_numbers(&node.world_from_node));
    }
    for node in graph.nodes().iter().filter(|node| node.fixed) {
        line("FIX", &[node.id], &[]);
    }
    for edge in graph.edges() {
        let upper = upper_triangle().map(|(i, j)| edge.information[(i, j)] / (half(i) * half(j)));
        let numbers: Vec<f64> = pose_numbers(&edge.from_from_to).into_iter().chain(upper).collect();
        line("EDGE_SE3:QUAT", &[edge.from, edge.to], &numbers);
    }
    text
}

fn pose_numbers(pose: &Se3) -> [f64; POSE_NUMBERS] {
    let Se3 { rotation: q, translation: t } = pose;
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// Rows and columns of the upper triangle, by row.
fn upper_triangle() -> impl Iterator<Item = (usize, usize)> {
    (0..6).flat_map(|i| (i..6).map(move |j| (i, j)))
}

/// `D` of the module's notes: a quaternion's vector part is half a rotation vector.
fn half(i: usize) -> f64 {
    if i < 3 { 1.0 } else { 0.5 }
}

/// A line that holds data, without its tag.
struct Line<'a> {
    name: &'a str,
    number: usize,
    tag: &'a str,
    fields: Vec<&'a str>,
}

impl Line<'_> {
    fn vertex(&self) -> Result<(NodeId, Se3), Error> {
        let pose = if self.tag == "VERTEX_SE2" {
            let [x, y, angle] = self.numbers(1, "an id and 3 numbers")?;
            planar_pose(x, y, angle)
        } else {
            spatial_pose(self.numbers(1, "an id and 7 numbers")?)
        };
        Ok((self.id(0)?, pose))
    }

    fn edge(&self) -> Result<Edge, Error> {
        let (from_from_to, information) = if self.tag == "EDGE_SE2" {
            let [x, y, angle, xx, xy, xa, yy, ya, aa] = self.numbers(2, "two ids and 9 numbers")?;
            (planar_pose(x, y, angle), planar_information([xx, xy, xa, yy, ya, aa]))
        } else {
            let numbers: [f64; POSE_NUMBERS + INFORMATION_NUMBERS] = self.numbers(2, "two ids and 28 numbers")?;
            let (pose, upper) = numbers.split_at(POSE_NUMBERS);
            let mut information = Matrix6::zeros();
            for ((i, j), value) in upper_triangle().zip(upper) {
                information[(i, j)] = value * half(i) * half(j);
                information[(j, i)] = information[(i, j)];
            }
            (spatial_pose(std::array::from_fn(|i| pose[i])), information)
        };
        let (from, to) = (self.id(0)?, self.id(1)?);
        let kind = if from.0.abs_diff(to.0) == 1 { EdgeKind::Sequential } else { EdgeKind::Loop };
        Ok(Edge { from, to, from_from_to, information, kernel: Kernel::None, kind })
    }

    fn id(&self, at: usize) -> Result<NodeId, Error> {
        let id = self.fields.get(at).and_then(|field| field.parse().ok());
        id.map(NodeId).ok_or_else(|| self.unexpected("a vertex's id, a whole number from 0", at))
    }

    /// All fields behind `ids` of them.
    fn numbers<const N: usize>(&self, ids: usize, expected: &str) -> Result<[f64; N], Error> {
        if self.fields.len() != ids + N {
            let found = format!("{} values", self.fields.len());
            return Err(self.error(&format!("{expected} after {}", self.tag), found));
        }
        let mut numbers = [0.0; N];
        for (at, number) in numbers.iter_mut().enumerate() {
            let finite = self.fields[ids + at].parse().ok().filter(|v: &f64| v.is_finite());
            *number = finite.ok_or_else(|| self.unexpected("a finite number", ids + at))?;
        }
        Ok(numbers)
    }

    /// An error about field number `at`.
    fn unexpected(&self, expected: &str, at: usize) -> Error {
        let field = self.fields.get(at).copied().unwrap_or_default();
        let start: String = field.chars().take(60).collect();
        self.error(expected, format!("'{start}'"))
    }

    fn error(&self, expected: &str, found: String) -> Error {
        Error::Line { name: self.name.to_owned(), line: self.number, expected: expected.to_owned(), found }
    }

    fn content(&self, reason: Error) -> Error {
        Error::Content { name: self.name.to_owned(), line: self.number, reason: Box::new(reason) }
    }
}

/// Not normalised yet: the graph checks it.
fn spatial_pose([x, y, z, qx, qy, qz, qw]: [f64; POSE_NUMBERS]) -> Se3 {
    Se3 { rotation: DQuat::from_xyzw(qx, qy, qz, qw), translation: DVec3::new(x, y, z) }
}

fn planar_pose(x: f64, y: f64, angle: f64) -> Se3 {
    Se3::new(DQuat::from_rotation_z(angle), DVec3::new(x, y, 0.0))
}

/// From the upper triangle over (x, y, θ).
fn planar_information([xx, xy, xa, yy, ya, aa]: [f64; 6]) -> Matrix6<f64> {
    let zz = 0.5 * (xx + yy);
    Matrix6::from_row_slice(&[
        xx, xy, 0.0, 0.0, 0.0, xa, //
        xy, yy, 0.0, 0.0, 0.0, ya, //
        0.0, 0.0, zz, 0.0, 0.0, 0.0, //
        0.0, 0.0, 0.0, aa, 0.0, 0.0, //
        0.0, 0.0, 0.0, 0.0, aa, 0.0, //
        xa, ya, 0.0, 0.0, 0.0, aa, //
    ])
}
