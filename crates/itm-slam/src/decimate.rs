//! Meshes of fewer triangles.
//!
//! This stands here and not beside [`Mesh`] because it is meshoptimizer's work, a library in C++: the vocabulary stays pure Rust
//! that builds anywhere, and the crates that only read or write files need no C++ compiler.

use itm_core::{GeometryError, Mesh};
use meshopt::{SimplifyOptions, VertexDataAdapter};
use thiserror::Error;

/// How much a normal turned by a radian counts, in mean lengths of an edge that a surface is displaced by. For a map's mesh that
/// is about half a voxel, so that the noise of normals, a tenth of a radian, stays below that of positions.
const NORMAL_WEIGHT: f32 = 0.5;
/// How much a colour channel's whole range counts, in the same unit.
const COLOUR_WEIGHT: f32 = 1.0;

/// Why a mesh could not be decimated.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum DecimateError {
    /// A ratio that is no share of triangles.
    #[error("the ratio of triangles to keep must be above 0 and at most 1, found {ratio}")]
    Ratio {
        /// As given.
        ratio: f32,
    },
    /// A mesh whose parts do not fit together.
    #[error("cannot decimate the mesh: {0}")]
    Geometry(#[from] GeometryError),
}

/// A mesh of about `ratio` times as many triangles, by collapsing the edges that change the surface least (quadric error
/// metrics: Garland and Heckbert 1997, with attributes as Hoppe 1999).
///
/// Its vertices are some of the mesh's, in their order, with the attributes that they had. Where the surface is flat and of one
/// colour triangles become large; edges, the outline of an open mesh and patterns of colour go last. Vertices and triangles
/// that are nothing (unused, without area because corners coincide) may go beyond the ratio; more triangles than asked for stay
/// where none can go without tearing the surface apart. The same mesh and ratio give the same result.
///
/// Positions are compared relative to the mesh's own corner, so that a mesh far from the world's origin comes out as one at it.
///
/// # Errors
/// A ratio that is not above 0 and at most 1, or a mesh that [`Mesh::check`] refuses.
pub fn decimate(mesh: &Mesh, ratio: f32) -> Result<Mesh, DecimateError> {
    if !(ratio > 0.0 && ratio <= 1.0) {
        return Err(DecimateError::Ratio { ratio });
    }
    // The library reads what indices point at without looking.
    mesh.check()?;
    if mesh.is_empty() {
        return Ok(Mesh::default());
    }

    let positions = VertexDataAdapter::new(bytemuck::cast_slice(&mesh.positions), size_of::<glam::Vec3>(), 0)
        .expect("a slice of positions holds whole positions");
    let (attributes, weights) = attributes(mesh, meshopt::simplify_scale(&positions));
    let target = (mesh.triangles.len() as f64 * f64::from(ratio)).round() as usize;
    let kept = meshopt::simplify_with_attributes_and_locks(
        mesh.triangles.as_flattened(),
        &positions,
        &attributes,
        &weights,
        size_of_val(&*weights),
        // None are locked. The library takes a list of none for one of all vertices, so it cannot be left out.
        &vec![false; mesh.positions.len()],
        3 * target.max(1),
        // The ratio alone says when to stop.
        f32::MAX,
        SimplifyOptions::None,
        None,
    );

    let mut decimated = Mesh { triangles: kept.as_chunks::<3>().0.to_vec(), ..mesh.clone() };
    decimated.compact();
    Ok(decimated)
}

/// The vertices' normals and colours, interleaved, and the weight of each part in the unit of positions, of which the largest
/// extent of the mesh is 1. A deviation counts by the length of edges, so that neither a mesh's extent nor its unit matters.
fn attributes(mesh: &Mesh, extent_m: f32) -> (Vec<f32>, Vec<f32>) {
    let unit = if extent_m > 0.0 { mean_edge_m(mesh) / extent_m } else { 0.0 };
    let mut weights = Vec::new();
    if !mesh.normals.is_empty() {
        weights.extend([NORMAL_WEIGHT * unit; 3]);
    }
    if !mesh.colours.is_empty() {
        weights.extend([COLOUR_WEIGHT * unit; 3]);
    }
    let mut values = Vec::with_capacity(mesh.positions.len() * weights.len());
    for i in 0..mesh.positions.len() {
        // A normal that is none must not make all errors around it incomparable.
        values
            .extend(mesh.normals.get(i).into_iter().flat_map(|n| if n.is_finite() { n.to_array() } else { [0.0; 3] }));
        values.extend(mesh.colours.get(i).into_iter().flat_map(|c| c.map(|c| f32::from(c) / 255.0)));
    }
    (values, weights)
}

/// Mean length of the triangles' edges in metres.
fn mean_edge_m(mesh: &Mesh) -> f32 {
    let length = |a: u32, b: u32| f64::from(mesh.positions[a as usize].distance(mesh.positions[b as usize]));
    let sum: f64 = mesh.triangles.iter().map(|&[a, b, c]| length(a, b) + length(b, c) + length(c, a)).sum();
    (sum / (3 * mesh.triangles.len()) as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use std::collections::HashMap;

    /// Between -1 and 1, by hashing.
    fn noise(seed: u32) -> f32 {
        let mut h = seed.wrapping_mul(0x9e37_79b9);
        h = (h ^ h >> 15).wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        (h & 0xffff) as f32 / 32767.5 - 1.0
    }

    /// A vertex of one colour, whose normal and weight tell which one it is.
    fn push_vertex(mesh: &mut Mesh, position: Vec3, normal: Vec3) {
        mesh.weights.push((mesh.positions.len() % 65_521) as u16);
        mesh.positions.push(position);
        mesh.normals.push(normal);
        mesh.colours.push([90, 120, 150]);
    }

    /// The square from 0 to 1 m in x and y, noise of `noise_m` in z, the outline level.
    fn plane(side: u32, noise_m: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for y in 0..=side {
            for x in 0..=side {
                let at_border = x == 0 || y == 0 || x == side || y == side;
                let z = if at_border { 0.0 } else { noise_m * noise(y * (side + 1) + x) };
                push_vertex(&mut mesh, Vec3::new(x as f32, y as f32, 0.0) / side as f32 + z * Vec3::Z, Vec3::Z);
            }
        }
        for y in 0..side {
            for x in 0..side {
                let a = y * (side + 1) + x;
                let [b, d] = [a + 1, a + side + 1];
                mesh.triangles.extend([[a, b, d + 1], [a, d + 1, d]]);
            }
        }
        mesh
    }

    /// A sphere of 1 m around the origin: an octahedron, subdivided, with noise along the radius.
    fn sphere(subdivisions: u32, noise_m: f32) -> Mesh {
        let mut points = vec![Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z];
        let mut triangles =
            vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
        for _ in 0..subdivisions {
            let mut middles = HashMap::new();
            let mut finer = Vec::new();
            for [a, b, c] in triangles {
                let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(a, b): (u32, u32)| {
                    *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                        points.push((points[a as usize] + points[b as usize]).normalize());
                        points.len() as u32 - 1
                    })
                });
                finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
            }
            triangles = finer;
        }
        let mut mesh = Mesh { triangles, ..Mesh::default() };
        for (i, point) in points.into_iter().enumerate() {
            push_vertex(&mut mesh, point * (1.0 + noise_m * noise(i as u32)), point);
        }
        mesh
    }

    fn corners(mesh: &Mesh) -> impl Iterator<Item = [Vec3; 3]> {
        mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize]))
    }

    /// Distance from a point to a triangle: to its plane where the point is over it, else to the nearest side.
    fn distance(p: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
        let normal = (b - a).cross(c - a).normalize();
        let sides = [(a, b), (b, c), (c, a)];
        if sides.iter().all(|&(from, to)| (to - from).cross(p - from).dot(normal) >= 0.0) {
            return (p - a).dot(normal).abs();
        }
        let to_side = |(from, to): (Vec3, Vec3)| {
            let along = ((p - from).dot(to - from) / (to - from).length_squared()).clamp(0.0, 1.0);
            p.distance(from + along * (to - from))
        };
        sides.map(to_side).into_iter().fold(f32::INFINITY, f32::min)
    }

    /// The largest distance from a vertex of `mesh` to the surface of `to`, a Hausdorff distance of one direction.
    fn largest_distance(mesh: &Mesh, to: &Mesh) -> f32 {
        let nearest = |p: &Vec3| corners(to).map(|t| distance(*p, t)).fold(f32::INFINITY, f32::min);
        mesh.positions.iter().map(nearest).fold(0.0, f32::max)
    }

    /// Vertices are those of `from` with what they had, all are used, and no triangle is without area.
    fn assert_taken_from(mesh: &Mesh, from: &Mesh) {
        mesh.check().unwrap();
        let index: HashMap<_, _> =
            from.positions.iter().enumerate().map(|(i, p)| (p.to_array().map(f32::to_bits), i)).collect();
        let mut used = vec![false; mesh.positions.len()];
        mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        for (i, position) in mesh.positions.iter().enumerate() {
            let original = index[&position.to_array().map(f32::to_bits)];
            assert!(used[i]);
            assert_eq!(
                (mesh.normals[i], mesh.colours[i], mesh.weights[i]),
                (from.normals[original], from.colours[original], from.weights[original])
            );
        }
        for (t, [a, b, c]) in mesh.triangles.iter().zip(corners(mesh)) {
            assert!((b - a).cross(c - a).length() > 1e-9, "{t:?} at {a}, {b}, {c}");
        }
    }

    fn assert_near(triangles: usize, expected: f32) {
        assert!((triangles as f32 / expected - 1.0).abs() < 0.02, "{triangles} triangles for {expected}");
    }

    #[test]
    fn a_sphere_stays_round_closed_and_outside_out() {
        let fine = sphere(5, 0.002);
        assert!(fine.is_watertight());
        // The flattest triangles possible would be off by 0.001, 0.006 and 0.03 m, noise aside.
        for (ratio, tolerance_m) in [(0.5, 0.004), (0.1, 0.02), (0.02, 0.09)] {
            let coarse = decimate(&fine, ratio).unwrap();
            assert_near(coarse.triangles.len(), ratio * fine.triangles.len() as f32);
            assert_taken_from(&coarse, &fine);
            assert!(coarse.is_watertight());
            assert!(corners(&coarse).all(|[a, b, c]| (b - a).cross(c - a).dot(a + b + c) > 0.0));
            let distance_m = largest_distance(&fine, &coarse);
            assert!(distance_m < tolerance_m, "{distance_m} m at {ratio}");
        }
    }

    #[test]
    fn a_plane_keeps_its_outline() {
        let fine = plane(50, 0.001);
        for ratio in [0.5, 0.1, 0.02] {
            let coarse = decimate(&fine, ratio).unwrap();
            assert_near(coarse.triangles.len(), ratio * fine.triangles.len() as f32);
            assert_taken_from(&coarse, &fine);
            // Seen from above, it still covers the whole square once.
            let area: f32 = corners(&coarse).map(|[a, b, c]| (b - a).cross(c - a).z / 2.0).sum();
            assert!((area - 1.0).abs() < 1e-4, "{area} m² at {ratio}");
            let distance_m = largest_distance(&fine, &coarse);
            assert!(distance_m < 0.003, "{distance_m} m at {ratio}");
        }
    }

    #[test]
    fn patterns_of_colour_outlive_what_is_plain() {
        let mut fine = plane(40, 0.0);
        for (position, colour) in fine.positions.iter().zip(&mut fine.colours) {
            if position.truncate().distance(glam::Vec2::splat(0.5)) < 0.2 {
                *colour = [250, 10, 10];
            }
        }
        let coarse = decimate(&fine, 0.2).unwrap();
        assert_taken_from(&coarse, &fine);
        let near_outline = |p: &&Vec3| (p.truncate().distance(glam::Vec2::splat(0.5)) - 0.2).abs() < 0.04;
        let share =
            |mesh: &Mesh| mesh.positions.iter().filter(near_outline).count() as f32 / mesh.positions.len() as f32;
        assert!(share(&coarse) > 2.0 * share(&fine), "{} of {}", share(&coarse), share(&fine));
    }

    #[test]
    fn far_from_the_origin_is_as_at_it() {
        // Of 16 bits behind the point, so that going 128 m away loses none of them.
        let mut near = sphere(4, 0.002);
        near.positions.iter_mut().for_each(|p| *p = (*p * 32768.0).round() / 32768.0);
        let offset = Vec3::new(128.0, -128.0, 128.0);
        let mut far = near.clone();
        far.positions.iter_mut().for_each(|p| *p += offset);
        let (near, mut far) = (decimate(&near, 0.1).unwrap(), decimate(&far, 0.1).unwrap());
        far.positions.iter_mut().for_each(|p| *p -= offset);
        assert_eq!(far, near);
    }

    #[test]
    fn the_same_comes_out_each_time() {
        let fine = sphere(4, 0.01);
        assert_eq!(decimate(&fine, 0.3).unwrap(), decimate(&fine, 0.3).unwrap());
    }

    #[test]
    fn a_ratio_of_one_keeps_all_triangles() {
        let fine = plane(5, 0.01);
        assert_eq!(decimate(&fine, 1.0).unwrap(), fine);
        let bare = Mesh { positions: fine.positions, triangles: fine.triangles, ..Mesh::default() };
        assert_eq!(decimate(&bare, 1.0).unwrap(), bare);
        let unknown = Mesh { normals: vec![Vec3::NAN; 36], ..bare };
        assert!((23..=26).contains(&decimate(&unknown, 0.5).unwrap().triangles.len()));
        assert_eq!(decimate(&Mesh::default(), 0.5).unwrap(), Mesh::default());
    }

    #[test]
    fn what_makes_no_sense_is_refused() {
        for ratio in [0.0, -0.5, 1.01, f32::NAN, f32::INFINITY] {
            let error = decimate(&plane(2, 0.0), ratio).unwrap_err();
            assert!(matches!(error, DecimateError::Ratio { .. }), "{error}");
        }
        let torn = Mesh { triangles: vec![[0, 1, 9]], ..plane(2, 0.0) };
        assert!(matches!(decimate(&torn, 0.5), Err(DecimateError::Geometry(_))));
        let point = Mesh { positions: vec![Vec3::ONE; 3], triangles: vec![[0, 1, 2]], ..Mesh::default() };
        assert!(decimate(&point, 0.5).unwrap().triangles.len() <= 1);
    }
}
