//! Triangle meshes.

mod components;
mod edges;

use glam::Vec3;

pub use components::DroppedComponents;

use crate::geometry::{self, GeometryError};

/// An indexed triangle mesh in world coordinates (metres).
///
/// Triangles are wound so that, seen from the side that `normals` point to (free space), their vertices run
/// counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions in metres.
    pub positions: Vec<Vec3>,
    /// Unit normals, one a vertex, pointing into free space.
    pub normals: Vec<Vec3>,
    /// Red, green, blue, one a vertex; empty where the map holds no colour.
    pub colours: Vec<[u8; 3]>,
    /// Smallest integration weight of the voxels that a vertex was made from (number of observations, up to the
    /// map's largest weight), one a vertex; empty where unknown.
    pub weights: Vec<u16>,
    /// Smaller confidence of the two voxels that a vertex was made from: how many of the sensor's best observations would tell
    /// as much. One a vertex; empty where the map keeps none.
    pub confidences: Vec<f32>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Whether there is no triangle.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Smallest and largest coordinates, or `None` without vertices.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        geometry::bounds(&self.positions)
    }

    /// Whether the mesh's parts fit together, so that triangles may index vertices and vertices their attributes.
    ///
    /// # Errors
    /// Attributes that are neither none nor as many as vertices, a position that is not finite, or a triangle of a
    /// vertex that is not there.
    pub fn check(&self) -> Result<(), GeometryError> {
        let counts = [self.normals.len(), self.colours.len(), self.weights.len(), self.confidences.len()];
        geometry::check_vertices(&self.positions, counts)?;
        let vertices = self.positions.len();
        let Some(i) = self.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= vertices)) else {
            return Ok(());
        };
        let [a, b, c] = self.triangles[i];
        let found = format!("triangle {i} of vertices {a}, {b} and {c} of {vertices}");
        Err(GeometryError { expected: "triangles of its vertices", found })
    }

    /// Gives each vertex the mean of its triangles' normals, weighted by their areas; zero where that says nothing, as for a
    /// vertex of no triangle.
    ///
    /// # Panics
    /// On a mesh that [`Mesh::check`] refuses.
    pub fn compute_normals(&mut self) {
        let mut sums = vec![Vec3::ZERO; self.positions.len()];
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|v| self.positions[v as usize]);
            // As long as twice the triangle's area.
            let normal = (b - a).cross(c - a);
            triangle.iter().for_each(|&v| sums[v as usize] += normal);
        }
        self.normals = sums.into_iter().map(Vec3::normalize_or_zero).collect();
    }

    /// What lies within the axis-aligned box from `min` to `max` (world coordinates, metres, both ends included):
    /// triangles with all three vertices in it, and the vertices that these use, in their order. Triangles that cross the
    /// box's sides are left out whole. A box whose `min` is beyond its `max` holds nothing.
    ///
    /// # Panics
    /// On a mesh that [`Mesh::check`] refuses.
    #[must_use]
    pub fn crop(mut self, min: Vec3, max: Vec3) -> Self {
        let inside: Vec<bool> = self.positions.iter().map(|p| p.cmpge(min).all() && p.cmple(max).all()).collect();
        self.triangles.retain(|t| t.iter().all(|&v| inside[v as usize]));
        self.compact();
        self
    }

    /// Drops the vertices that no triangle uses, with their attributes. Vertices and triangles keep their order.
    ///
    /// # Panics
    /// On a mesh that [`Mesh::check`] refuses.
    pub fn compact(&mut self) {
        let mut used = vec![false; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        if used.iter().all(|&used| used) {
            return;
        }
        keep_used(&mut self.positions, &used);
        keep_used(&mut self.normals, &used);
        keep_used(&mut self.colours, &used);
        keep_used(&mut self.weights, &used);
        keep_used(&mut self.confidences, &used);
        // Each used vertex goes down by the number of unused ones before it.
        let counts = used.iter().scan(0, |before, &used| {
            let moved_to = *before;
            *before += u32::from(used);
            Some(moved_to)
        });
        let moved_to: Vec<u32> = counts.collect();
        self.triangles.iter_mut().flatten().for_each(|v| *v = moved_to[*v as usize]);
    }
}

/// Keeps the attributes of used vertices; none stay none.
fn keep_used<T>(attributes: &mut Vec<T>, used: &[bool]) {
    let mut used = used.iter();
    attributes.retain(|_| used.next().copied().unwrap_or_default());
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A flat grid of `side` x `side` squares of 1 m in z = 0, whose attributes tell which vertex they are of.
    pub(crate) fn grid(side: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for y in 0..=side {
            for x in 0..=side {
                push_numbered(&mut mesh, Vec3::new(x as f32, y as f32, 0.0));
            }
        }
        let vertex = |x, y| y * (side + 1) + x;
        for y in 0..side {
            for x in 0..side {
                let [a, b, c, d] = [vertex(x, y), vertex(x + 1, y), vertex(x + 1, y + 1), vertex(x, y + 1)];
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        mesh
    }

    /// A vertex whose attributes are made from its position, so that a mix-up shows.
    pub(crate) fn push_numbered(mesh: &mut Mesh, position: Vec3) {
        let [x, y, z] = position.to_array().map(|c| c as i32 as u8);
        mesh.positions.push(position);
        mesh.normals.push((position + Vec3::ONE).normalize());
        mesh.colours.push([x, y, z]);
        mesh.weights.push(u16::from(x) << 8 | u16::from(y));
        mesh.confidences.push(position.x + 0.5 * position.y);
    }

    pub(crate) fn assert_in_step(mesh: &Mesh) {
        mesh.check().unwrap();
        let mut expected = Mesh { triangles: mesh.triangles.clone(), ..Mesh::default() };
        mesh.positions.iter().for_each(|p| push_numbered(&mut expected, *p));
        assert_eq!(*mesh, expected);
    }

    /// The corners of each triangle.
    pub(crate) fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
        mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect()
    }

    #[test]
    fn crop_keeps_whole_triangles_and_their_vertices() {
        let cropped = grid(9).crop(Vec3::new(2.0, 3.0, -1.0), Vec3::new(5.0, 7.5, 1.0));
        assert_eq!((cropped.triangles.len(), cropped.positions.len()), (2 * 3 * 4, 4 * 5));
        assert_eq!(cropped.bounds(), Some((Vec3::new(2.0, 3.0, 0.0), Vec3::new(5.0, 7.0, 0.0))));
        assert_in_step(&cropped);
    }

    #[test]
    fn crop_to_everything_or_nothing() {
        let all = grid(4).crop(Vec3::splat(-1e9), Vec3::splat(1e9));
        assert_eq!(all, grid(4));
        let (low, high) = (Vec3::ZERO, Vec3::splat(4.0));
        assert_eq!(grid(4).crop(low, high), grid(4), "the box's sides belong to it");
        assert_eq!(grid(4).crop(high, low), Mesh::default());
        assert_eq!(grid(4).crop(Vec3::NAN, high), Mesh::default());
        assert_eq!(Mesh::default().crop(low, high), Mesh::default());
    }

    #[test]
    fn attributes_that_are_not_there_stay_so() {
        let bare = Mesh { positions: grid(3).positions, triangles: grid(3).triangles, ..Mesh::default() };
        let cropped = bare.crop(Vec3::ZERO, Vec3::ONE);
        assert_eq!((cropped.positions.len(), cropped.triangles.len()), (4, 2));
        assert!(
            cropped.normals.is_empty()
                && cropped.colours.is_empty()
                && cropped.weights.is_empty()
                && cropped.confidences.is_empty()
        );
    }

    proptest! {
        #[test]
        fn compacting_changes_no_triangle(kept in prop::collection::vec(any::<bool>(), 2 * 5 * 5)) {
            let mut mesh = grid(5);
            let mut keep = kept.into_iter();
            mesh.triangles.retain(|_| keep.next().unwrap());
            let before = corners(&mesh);
            mesh.compact();
            prop_assert_eq!(corners(&mesh), before);
            assert_in_step(&mesh);
            let mut used: Vec<_> = mesh.triangles.as_flattened().to_vec();
            used.sort_unstable();
            used.dedup();
            prop_assert_eq!(used.len(), mesh.positions.len());
        }
    }

    #[test]
    fn computed_normals_are_weighted_by_area() {
        // A right angle along x, whose side in z = 0 is twice as large as the one in y = 0.
        let mut mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, 2.0 * Vec3::Y, Vec3::Z, Vec3::ONE],
            triangles: vec![[0, 1, 2], [0, 1, 3]],
            ..Mesh::default()
        };
        mesh.compute_normals();
        let shared = Vec3::new(0.0, -1.0, 2.0).normalize();
        for (found, expected) in mesh.normals.iter().zip([shared, shared, Vec3::Z, Vec3::NEG_Y, Vec3::ZERO]) {
            assert!(found.abs_diff_eq(expected, 1e-6), "{found} instead of {expected}");
        }
        mesh.check().unwrap();
    }

    #[test]
    fn parts_that_do_not_fit_are_named() {
        let refused = |mesh: Mesh| mesh.check().unwrap_err().to_string();
        assert!(grid(2).check().is_ok() && Mesh::default().check().is_ok());
        let error = refused(Mesh { normals: vec![Vec3::X], ..grid(2) });
        assert!(error.contains("found 1 normals for 9 vertices"), "{error}");
        let error = refused(Mesh { triangles: vec![[0, 1, 2], [3, 9, 4]], ..grid(2) });
        assert!(error.contains("triangle 1 of vertices 3, 9 and 4 of 9"), "{error}");
        let mut mesh = grid(2);
        mesh.positions[2].y = f32::NAN;
        assert!(refused(mesh).contains("vertex 2"));
    }
}
