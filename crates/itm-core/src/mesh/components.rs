//! Connected parts of a mesh.

use super::Mesh;

/// What [`Mesh::drop_small_components`] left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DroppedComponents {
    /// Number of components.
    pub components: usize,
    /// Number of triangles in them.
    pub triangles: usize,
}

impl Mesh {
    /// Drops the components of fewer than `min_triangles` triangles, and all vertices that no triangle uses then.
    /// Triangles that share a vertex, by its index, are of one component. What stays keeps its order.
    ///
    /// # Panics
    /// On a mesh that [`Mesh::check`] refuses.
    pub fn drop_small_components(&mut self, min_triangles: usize) -> DroppedComponents {
        let mut sets = DisjointSets::new(self.positions.len());
        for &[a, b, c] in &self.triangles {
            sets.unite(a, b);
            sets.unite(b, c);
        }
        let mut sizes = vec![0_usize; self.positions.len()];
        for &[a, _, _] in &self.triangles {
            sizes[sets.root(a) as usize] += 1;
        }
        let small = |size: usize| size < min_triangles;
        let dropped = sizes.iter().filter(|&&size| size > 0 && small(size));
        let dropped = DroppedComponents { components: dropped.clone().count(), triangles: dropped.sum() };
        self.triangles.retain(|&[a, _, _]| !small(sizes[sets.root(a) as usize]));
        self.compact();
        dropped
    }
}

/// Union-find (Galler and Fischer 1964) over indices.
struct DisjointSets {
    /// An element of the same set that is not larger; a root is its own.
    parents: Vec<u32>,
}

impl DisjointSets {
    /// Each of `count` elements on its own.
    fn new(count: usize) -> Self {
        // Meshes index vertices by 32 bits, so those beyond are in no triangle and need no set.
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        Self { parents: (0..count).collect() }
    }

    /// The smallest element of the set that `element` is in. Halves the path to it, so that the next look-up is short.
    fn root(&mut self, mut element: u32) -> u32 {
        loop {
            let parent = self.parents[element as usize];
            if parent == element {
                return element;
            }
            let grandparent = self.parents[parent as usize];
            self.parents[element as usize] = grandparent;
            element = grandparent;
        }
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{assert_in_step, grid, push_numbered};
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    /// Strips of the given numbers of triangles, none of which shares a vertex with another, their triangles interleaved.
    fn strips(lengths: &[usize]) -> Mesh {
        let mut mesh = Mesh::default();
        let mut triangles = Vec::new();
        for (y, &length) in lengths.iter().enumerate() {
            let first = mesh.positions.len() as u32;
            for i in 0..length + 2 {
                push_numbered(&mut mesh, Vec3::new(i as f32, 2.0 * y as f32 + (i % 2) as f32, 0.0));
            }
            triangles.extend((0..length as u32).map(|i| (i, [first + i, first + i + 1, first + i + 2])));
        }
        // The n-th triangle of each strip before the next one of any.
        triangles.sort_by_key(|&(i, _)| i);
        mesh.triangles = triangles.into_iter().map(|(_, t)| t).collect();
        mesh
    }

    #[test]
    fn small_components_go_with_their_vertices() {
        let mut mesh = strips(&[5, 1, 40, 4, 2]);
        assert_eq!(mesh.drop_small_components(5), DroppedComponents { components: 3, triangles: 7 });
        assert_eq!((mesh.triangles.len(), mesh.positions.len()), (45, 7 + 42));
        assert_in_step(&mesh);
    }

    #[test]
    fn one_shared_vertex_connects() {
        let mut mesh = strips(&[3, 3]);
        let (first, last) = (mesh.triangles[0][0], mesh.triangles[5][2]);
        mesh.triangles.push([first, first, last]);
        assert_eq!(mesh.drop_small_components(7), DroppedComponents::default());
        assert_eq!(mesh.drop_small_components(8), DroppedComponents { components: 1, triangles: 7 });
        assert_eq!(mesh, Mesh::default());
    }

    #[test]
    fn no_limit_drops_nothing_but_unused_vertices() {
        let mut mesh = grid(3);
        push_numbered(&mut mesh, Vec3::splat(7.0));
        for limit in [0, 1] {
            assert_eq!(mesh.drop_small_components(limit), DroppedComponents::default());
            assert_eq!(mesh, grid(3));
        }
        assert_eq!(Mesh::default().drop_small_components(9), DroppedComponents::default());
    }

    proptest! {
        #[test]
        fn as_many_go_as_are_small(lengths in prop::collection::vec(1..12_usize, 0..12), limit in 0..14_usize) {
            let mut mesh = strips(&lengths);
            let small: Vec<usize> = lengths.iter().copied().filter(|&l| l < limit).collect();
            let dropped = mesh.drop_small_components(limit);
            prop_assert_eq!((dropped.components, dropped.triangles), (small.len(), small.iter().sum()));
            prop_assert_eq!(mesh.triangles.len(), lengths.iter().sum::<usize>() - dropped.triangles);
            assert_in_step(&mesh);
        }
    }
}
