//! The table of marching cubes, made from its rule rather than written down.
//!
//! A cell's surface meets each face of the cube in segments that depend on that face's four signs alone: each run of
//! negative corners is cut off by a segment of its own, so that on an ambiguous face the negative corners are separated.
//! Both cells at a face then agree, and no hole can arise, which the original 15 cases (Lorensen & Cline 1987, *Marching
//! Cubes*) do not ensure (Nielson & Hamann 1991, *The Asymptotic Decider*; Montani, Scateni & Scopigno 1994, *A modified
//! look-up table for implicit disambiguation of Marching Cubes*). The segments close to loops, and each loop is cut into
//! triangles.
//!
//! Corner `c` of a cell lies at `(c & 1, (c >> 1) & 1, c >> 2)`, and bit `c` of the case is set where its distance is
//! negative. Edge `4 * axis + k` runs along an axis from the corner that has the bits of `k` in the two other axes.

/// Words of one case: the number of triangles, then three edges each.
pub(crate) const CASE_WORDS: usize = 16;
const EDGES: usize = 12;

/// The corners of each face, counter-clockwise as seen from outside.
fn faces() -> [[usize; 4]; 6] {
    std::array::from_fn(|face| {
        let (axis, far) = (face / 2, face % 2);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let corner = |a: usize, b: usize| (far << axis) | (a << u) | (b << v);
        let seen_from_far = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
        if far == 1 { seen_from_far } else { std::array::from_fn(|i| seen_from_far[3 - i]) }
    })
}

/// The edge between two neighbouring corners.
fn edge_between(a: usize, b: usize) -> usize {
    let (axis, start) = ((a ^ b).ilog2() as usize, a & b);
    let below = start & ((1 << axis) - 1);
    4 * axis + (below | (start >> (axis + 1)) << axis)
}

/// The corner that an edge starts from; it ends one further along axis `edge / 4`.
pub(crate) fn edge_start(edge: usize) -> usize {
    let (axis, k) = (edge / 4, edge % 4);
    let below = k & ((1 << axis) - 1);
    below | (k >> axis) << (axis + 1)
}

/// Whether two edges lie on one face of the cube.
fn share_face(a: usize, b: usize) -> bool {
    (0..3).any(|axis| a / 4 != axis && b / 4 != axis && (edge_start(a) ^ edge_start(b)) >> axis & 1 == 0)
}

/// The loops in which a cell's surface meets the cube's edges, each counter-clockwise as seen from the positive side.
fn loops(case: u8) -> Vec<Vec<usize>> {
    let negative = |corner: usize| case >> corner & 1 == 1;
    // Around a face as seen from outside, a segment leads from where a run of negative corners begins to where it ends.
    // The face's other cell sees the same segment the other way round, as it must for a consistent orientation.
    let mut next = [None; EDGES];
    for face in faces() {
        for first in 0..4 {
            let corner = |i: usize| face[(first + i) % 4];
            if !negative(corner(0)) && negative(corner(1)) {
                let last = (1..4).take_while(|&i| negative(corner(i))).count();
                next[edge_between(corner(0), corner(1))] = Some(edge_between(corner(last), corner(last + 1)));
            }
        }
    }
    let mut loops = Vec::new();
    for start in 0..EDGES {
        let mut ring = Vec::new();
        let mut edge = start;
        while let Some(following) = next[edge].take() {
            ring.push(edge);
            edge = following;
        }
        if !ring.is_empty() {
            loops.push(ring);
        }
    }
    loops
}

/// A case's triangles, each as three edges, counter-clockwise as seen from the positive side.
pub(crate) fn triangles(case: u8) -> Vec<[usize; 3]> {
    let mut triangles = Vec::new();
    for ring in loops(case) {
        let n = ring.len();
        // A fan, from an apex none of whose diagonals lies on a face of the cube: there, the next cell could have the
        // same diagonal, and an edge would bear four triangles.
        let apex = (0..n)
            .find(|apex| (2..n - 1).all(|i| !share_face(ring[*apex], ring[(apex + i) % n])))
            .expect("each of the 256 cases has such an apex, as a test tells");
        triangles.extend((1..n - 1).map(|i| [ring[apex], ring[(apex + i) % n], ring[(apex + i + 1) % n]]));
    }
    triangles
}

/// The table as the shaders read it: [`CASE_WORDS`] words for each of the 256 cases.
pub(crate) fn table() -> Vec<u32> {
    let mut table = Vec::with_capacity(256 * CASE_WORDS);
    for case in 0..=255 {
        let triangles = triangles(case);
        let words = std::iter::once(triangles.len()).chain(triangles.into_iter().flatten()).map(|w| w as u32);
        table.extend(words);
        table.resize((usize::from(case) + 1) * CASE_WORDS, 0);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{IVec3, Vec3};
    use proptest::prelude::*;
    use std::collections::{HashMap, HashSet};

    fn position(corner: usize) -> IVec3 {
        IVec3::new(corner as i32 & 1, corner as i32 >> 1 & 1, corner as i32 >> 2)
    }

    #[test]
    fn every_case_fits_its_words_and_uses_exactly_the_edges_whose_ends_differ() {
        for case in 0..=255u8 {
            let triangles = triangles(case);
            assert!(3 * triangles.len() < CASE_WORDS, "case {case} has {} triangles", triangles.len());
            let used: HashSet<usize> = triangles.into_iter().flatten().collect();
            let crossed = (0..EDGES).filter(|&e| {
                let start = edge_start(e);
                (case >> start ^ case >> (start | 1 << (e / 4))) & 1 == 1
            });
            assert_eq!(used, crossed.collect(), "case {case}");
        }
    }

    #[test]
    fn edges_have_one_number_whichever_way_they_are_named() {
        for e in 0..EDGES {
            let (start, end) = (edge_start(e), edge_start(e) | 1 << (e / 4));
            assert_eq!((edge_between(start, end), edge_between(end, start)), (e, e));
            assert_eq!(end.count_ones(), start.count_ones() + 1);
        }
    }

    #[test]
    fn a_single_negative_corner_is_cut_off_by_a_triangle_that_faces_away_from_it() {
        for corner in 0..8 {
            let [triangle] = triangles(1 << corner)[..] else { panic!("one triangle for corner {corner}") };
            let [a, b, c] = triangle.map(|e| {
                let axis = Vec3::from_array(std::array::from_fn(|i| if i == e / 4 { 0.5 } else { 0.0 }));
                position(edge_start(e)).as_vec3() + axis
            });
            let towards_middle = Vec3::splat(0.5) - position(corner).as_vec3();
            assert!((b - a).cross(c - a).dot(towards_middle) > 0.0, "corner {corner}");
        }
    }

    proptest! {
        /// Whatever the signs, a solid within a positive rim has a closed surface on which each edge joins two triangles
        /// that pass it in opposite directions.
        #[test]
        fn random_solids_are_closed(signs in prop::collection::vec(any::<bool>(), 64)) {
            let negative = |p: IVec3| {
                let q = p - IVec3::ONE;
                q.min_element() >= 0 && q.max_element() < 4 && signs[(q.x + 4 * q.y + 16 * q.z) as usize]
            };
            let mut passes: HashMap<[(IVec3, usize); 2], usize> = HashMap::new();
            for (x, y, z) in (0..125).map(|i| (i % 5, i / 5 % 5, i / 25)) {
                let cell = IVec3::new(x, y, z);
                let case = (0..8).filter(|&c| negative(cell + position(c))).map(|c| 1u8 << c).sum();
                for triangle in triangles(case) {
                    let vertices = triangle.map(|e| (cell + position(edge_start(e)), e / 4));
                    for i in 0..3 {
                        *passes.entry([vertices[i], vertices[(i + 1) % 3]]).or_default() += 1;
                    }
                }
            }
            for ([a, b], count) in &passes {
                prop_assert_eq!(*count, 1, "{:?} to {:?}", a, b);
                prop_assert!(passes.contains_key(&[*b, *a]), "{:?} to {:?} has no other side", a, b);
            }
        }
    }
}
