//! Triangle meshes.

use glam::Vec3;

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
        let first = *self.positions.first()?;
        Some(self.positions.iter().fold((first, first), |(lo, hi), p| (lo.min(*p), hi.max(*p))))
    }
}
