//! Where a mesh is open.

use super::Mesh;

impl Mesh {
    /// The directed edges of triangles, as their winding runs, that lack their one counterpart: those at the border, those
    /// of three or more triangles, and those that two triangles run along in the same direction. Sorted; edges are told
    /// apart by their vertices' indices, so vertices at one place that are not shared leave a border between them.
    pub fn boundary_edges(&self) -> Vec<[u32; 2]> {
        let directed = self.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        // Both directions of an edge side by side, the rising one first.
        let mut edges: Vec<([u32; 2], bool)> =
            directed.map(|[from, to]| ([from.min(to), from.max(to)], from > to)).collect();
        edges.sort_unstable();
        let mut boundary = Vec::new();
        for same in edges.chunk_by(|a, b| a.0 == b.0) {
            if !matches!(same, [(_, false), (_, true)]) {
                boundary.extend(same.iter().map(|&([low, high], falls)| if falls { [high, low] } else { [low, high] }));
            }
        }
        boundary.sort_unstable();
        boundary
    }

    /// Whether each edge is shared by exactly two triangles that run along it in opposite directions, so that the mesh
    /// is closed and wound consistently. A mesh without triangles encloses nothing and is not.
    pub fn is_watertight(&self) -> bool {
        !self.is_empty() && self.boundary_edges().is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::grid;
    use super::*;

    fn of(triangles: &[[u32; 3]]) -> Mesh {
        Mesh { triangles: triangles.to_vec(), ..Mesh::default() }
    }

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    #[test]
    fn closed_meshes_have_no_boundary() {
        assert!(of(&TETRAHEDRON).is_watertight());
        assert!(!Mesh::default().is_watertight());
    }

    #[test]
    fn a_missing_triangle_leaves_its_edges() {
        let mesh = of(&TETRAHEDRON[1..]);
        // As the neighbours run along them: against the missing triangle.
        assert_eq!(mesh.boundary_edges(), [[0, 1], [1, 2], [2, 0]]);
        assert!(!mesh.is_watertight());
        assert_eq!(grid(7).boundary_edges().len(), 4 * 7);
    }

    #[test]
    fn a_turned_triangle_or_a_third_one_is_seen() {
        let mut turned = TETRAHEDRON;
        turned[0].swap(0, 1);
        assert_eq!(of(&turned).boundary_edges().len(), 6);

        let fin = [&TETRAHEDRON[..], &[[0, 1, 4]]].concat();
        assert_eq!(of(&fin).boundary_edges(), [[0, 1], [0, 1], [1, 0], [1, 4], [4, 0]]);
        assert!(!of(&[&TETRAHEDRON[..], &TETRAHEDRON[..]].concat()).is_watertight());
        assert!(of(&[[3, 3, 3]]).boundary_edges().contains(&[3, 3]));
    }
}
