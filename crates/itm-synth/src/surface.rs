//! The scene's surface as a mesh.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use itm_core::Mesh;
use rayon::prelude::*;

use crate::render::colour_at;
use crate::{Error, Scene};

/// Cells along a block's edge: whole blocks far from surfaces are skipped.
const BLOCK: i32 = 8;
/// Farthest that a vertex may be from the surface, in metres.
const TOLERANCE_M: f32 = 1e-5;

/// The surfaces within a scene's bounds as a mesh, whose vertices lie on them to within 0.01 mm and have the colours
/// that a camera sees.
///
/// Surface nets (Gibson 1998, *Constrained Elastic Surface Nets*): one vertex in each cell of a grid that the surface
/// crosses, a quadrilateral around each edge that it crosses; each vertex is then moved onto the surface. Between
/// vertices, curved surfaces and sharp edges are off by up to about `cell_m`, and what is thinner than `cell_m` may be
/// missing.
///
/// # Errors
/// Where `cell_m`, the edge of a cell in metres, is not positive or gives too many cells to count.
pub fn exact_mesh(scene: &Scene, cell_m: f32) -> Result<Mesh, Error> {
    let bounds = scene.bounds();
    // One cell more on each side, so that walls right on the bounds are inside. The half keeps grid points off them.
    let origin = bounds.min - 1.5 * cell_m;
    let size = ((bounds.max - bounds.min) / cell_m + 3.0).ceil();
    if !(cell_m > 0.0 && size.max_element() < 100_000.0) {
        let expected = "positive, and not below a hundred-thousandth of the scene";
        return Err(Error::Value { name: "the size of a cell in metres", expected, found: f64::from(cell_m) });
    }
    let grid = CellGrid { scene, origin, cell_m, size: size.as_ivec3() };

    let blocks = (grid.size + BLOCK - 1) / BLOCK;
    let crossed: Vec<Crossed> = (0..blocks.z)
        .into_par_iter()
        .flat_map_iter(|z| {
            (0..blocks.y * blocks.x).flat_map(move |i| grid.block(IVec3::new(i % blocks.x, i / blocks.x, z)))
        })
        .collect();
    let number: HashMap<IVec3, u32> = crossed.iter().zip(0..).map(|(c, i)| (c.cell, i)).collect();

    let mut triangles = Vec::with_capacity(2 * crossed.len());
    for &Crossed { cell, inside, .. } in &crossed {
        // The three edges from the cell's first corner; the other edges are some other cell's.
        for (axis, u, v) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
            let (here, there) = (inside & 1 != 0, inside >> (1 << axis) & 1 != 0);
            if here == there {
                continue;
            }
            let (u, v) = (IVec3::AXES[u], IVec3::AXES[v]);
            // Counter-clockwise as seen against the axis.
            let around = [cell - u - v, cell - v, cell, cell - u].map(|c| number.get(&c).copied());
            let [Some(a), Some(b), Some(c), Some(d)] = around else { continue };
            let [a, b, c, d] = if here { [a, b, c, d] } else { [d, c, b, a] };
            let at = |i: u32| crossed[i as usize].vertex;
            // The shorter diagonal gives the better triangles.
            if at(a).distance_squared(at(c)) <= at(b).distance_squared(at(d)) {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    let positions: Vec<Vec3> = crossed.iter().map(|c| c.vertex).collect();
    let normals = positions.par_iter().map(|p| scene.sample(*p).map_or(-Vec3::Y, |s| s.normal)).collect();
    let colours = positions.par_iter().map(|p| colour_at(scene, *p)).collect();
    Ok(Mesh { positions, normals, colours, triangles, ..Mesh::default() })
}

/// A cell that the surface crosses.
struct Crossed {
    cell: IVec3,
    /// Bit `x + 2 y + 4 z` is set where that corner lies inside an object.
    inside: u32,
    vertex: Vec3,
}

#[derive(Clone, Copy)]
struct CellGrid<'a> {
    scene: &'a Scene,
    origin: Vec3,
    cell_m: f32,
    /// Number of cells along each axis.
    size: IVec3,
}

impl CellGrid<'_> {
    fn corner(&self, corner: IVec3) -> Vec3 {
        self.origin + corner.as_vec3() * self.cell_m
    }

    /// The crossed cells of a block.
    fn block(&self, block: IVec3) -> Vec<Crossed> {
        let first = block * BLOCK;
        let half = 0.5 * BLOCK as f32;
        let middle = self.origin + (first.as_vec3() + half) * self.cell_m;
        if self.scene.distance(middle).abs() > 1.01 * half * 3f32.sqrt() * self.cell_m {
            return Vec::new();
        }
        let side = BLOCK + 1;
        let distances: Vec<f32> = (0..side * side * side)
            .map(|i| {
                let local = IVec3::new(i % side, i / side % side, i / (side * side));
                self.scene.distance(self.corner(first + local))
            })
            .collect();
        let mut crossed = Vec::new();
        for i in 0..BLOCK * BLOCK * BLOCK {
            let local = IVec3::new(i % BLOCK, i / BLOCK % BLOCK, i / (BLOCK * BLOCK));
            let cell = first + local;
            if cell.cmpge(self.size).any() {
                continue;
            }
            let corners: [f32; 8] = std::array::from_fn(|c| {
                let at = local + corner_offset(c);
                distances[(at.x + side * (at.y + side * at.z)) as usize]
            });
            let inside = (0..8).filter(|&c| corners[c] < 0.0).fold(0, |mask, c| mask | 1 << c);
            if inside != 0 && inside != 0xff {
                crossed.push(Crossed { cell, inside, vertex: self.vertex(cell, &corners) });
            }
        }
        crossed
    }

    /// A point on the surface in or near a cell.
    fn vertex(&self, cell: IVec3, corners: &[f32; 8]) -> Vec3 {
        let edges = || {
            (0..8usize)
                .flat_map(|a| [1, 2, 4].map(|bit| (a, a | bit)))
                .filter(|&(a, b)| a != b && (corners[a] < 0.0) != (corners[b] < 0.0))
        };
        let at = |c: usize| self.corner(cell + corner_offset(c));
        let (mut sum, mut count) = (Vec3::ZERO, 0.0);
        for (a, b) in edges() {
            sum += at(a).lerp(at(b), corners[a] / (corners[a] - corners[b]));
            count += 1.0;
        }
        let start = sum / count;
        let mut p = start;
        for _ in 0..16 {
            let Some(sample) = self.scene.sample(p) else { break };
            if sample.distance.abs() < TOLERANCE_M && p.distance(start) < 1.5 * self.cell_m {
                return p;
            }
            p -= sample.distance * sample.normal;
        }
        // Where surfaces meet sharply that may run away or go around in circles. Along an edge it cannot.
        let (a, b) = edges().next().expect("a crossed cell has a crossed edge");
        let (mut inside, mut outside) = if corners[a] < 0.0 { (at(a), at(b)) } else { (at(b), at(a)) };
        for _ in 0..24 {
            let middle = inside.midpoint(outside);
            if self.scene.distance(middle) < 0.0 {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        outside
    }
}

fn corner_offset(corner: usize) -> IVec3 {
    IVec3::new((corner & 1) as i32, (corner >> 1 & 1) as i32, (corner >> 2 & 1) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bounds, Material, Object, Shape};

    fn area(mesh: &Mesh) -> f32 {
        mesh.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum()
    }

    #[test]
    fn a_ball_is_closed_round_and_the_right_way_out() {
        let ball = Object::new(Shape::Sphere { radius: 0.5 }, Material::default()).at(0.1, 0.2, 0.3);
        let scene = Scene::new(vec![ball], Bounds::new(Vec3::splat(-1.0), Vec3::splat(1.0)));
        let mesh = exact_mesh(&scene, 0.04).unwrap();
        let expected = std::f32::consts::PI;
        assert!((area(&mesh) / expected - 1.0).abs() < 0.01, "{} m² instead of {expected}", area(&mesh));
        let mut edges = HashMap::new();
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            assert!((b - a).cross(c - a).dot(a - Vec3::new(0.1, 0.2, 0.3)) >= 0.0, "a triangle faces inwards");
            for k in 0..3 {
                *edges.entry((t[k], t[(k + 1) % 3])).or_insert(0) += 1;
            }
        }
        for (&(a, b), &n) in &edges {
            assert!(n == 1 && edges.get(&(b, a)) == Some(&1), "edge {a}-{b} is not between two triangles");
        }
    }

    #[test]
    fn the_rooms_vertices_lie_on_its_surface() {
        let scene = Scene::room();
        let mesh = exact_mesh(&scene, 0.06).unwrap();
        assert!(mesh.positions.len() > 20_000, "{} vertices", mesh.positions.len());
        assert_eq!(mesh.positions.len(), mesh.normals.len());
        assert_eq!(mesh.positions.len(), mesh.colours.len());
        for p in &mesh.positions {
            assert!(scene.distance(*p).abs() < 1e-4, "{p} is {} m off", scene.distance(*p));
        }
        let (lo, hi) = mesh.bounds().unwrap();
        let room = scene.bounds();
        assert!(lo.abs_diff_eq(room.min, 1e-4) && hi.abs_diff_eq(room.max, 1e-4), "from {lo} to {hi}");
        assert_eq!(mesh, exact_mesh(&scene, 0.06).unwrap());
    }

    #[test]
    fn cells_of_no_size_are_refused() {
        let scene = Scene::room();
        for cell_m in [0.0, -1.0, f32::NAN, 1e-7] {
            assert!(matches!(exact_mesh(&scene, cell_m), Err(Error::Value { .. })));
        }
    }
}
