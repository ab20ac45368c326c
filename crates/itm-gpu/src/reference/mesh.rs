//! Reference of stage `mesh`: marching cubes (Lorensen & Cline 1987, *Marching Cubes: A High Resolution 3D Surface
//! Construction Algorithm*), cell by cell.

use std::collections::HashMap;

use glam::{DVec3, IVec3};
use itm_core::Mesh;
use itm_core::voxel::{BLOCK_SIDE, DistanceVoxel};

use super::Map;
use super::map::corners;
use crate::mesh::{edge_start, triangles_of_case};

/// An edge of the lattice: the voxel that it starts from, and its axis.
type Edge = (IVec3, usize);

/// Meshes a map, block by block in the order of [`Map::positions`]. A cell counts where its eight voxels have at least
/// weight `min_weight`, and one in any case. Colours where asked for.
pub fn extract(map: &Map, min_weight: u16, coloured: bool) -> Mesh {
    let mut mesh = Mesh::default();
    let mut numbers: HashMap<Edge, u32> = HashMap::new();
    for block in map.positions() {
        for cell in voxels_of(block) {
            for triangle in triangles_of_cell(map, cell, min_weight.max(1)) {
                let vertices = triangle.map(|edge| {
                    *numbers.entry(edge).or_insert_with(|| {
                        push_vertex(&mut mesh, map, edge, coloured);
                        mesh.positions.len() as u32 - 1
                    })
                });
                mesh.triangles.push(vertices);
            }
        }
    }
    mesh
}

fn voxels_of(block: IVec3) -> impl Iterator<Item = IVec3> {
    let side = 0..BLOCK_SIDE;
    let first = block * BLOCK_SIDE;
    side.clone().flat_map(move |z| {
        let side = side.clone();
        side.clone().flat_map(move |y| side.clone().map(move |x| first + IVec3::new(x, y, z)))
    })
}

/// The triangles of the cell between a voxel and its next ones, each as three edges.
fn triangles_of_cell(map: &Map, cell: IVec3, min_weight: u16) -> Vec<[Edge; 3]> {
    let voxels: Vec<DistanceVoxel> = corners().map(|corner| map.distance(cell + corner)).collect();
    if voxels.iter().any(|v| v.weight() < min_weight) {
        return Vec::new();
    }
    let case = (0..8).filter(|&c| voxels[c].distance() < 0.0).map(|c| 1 << c).sum();
    let corner = |c: usize| corners().nth(c).expect("edges start from one of eight corners");
    let on_lattice = |edge: usize| (cell + corner(edge_start(edge)), edge / 4);
    triangles_of_case(case).into_iter().map(|triangle| triangle.map(on_lattice)).collect()
}

/// Appends the vertex on an edge whose ends differ in sign.
fn push_vertex(mesh: &mut Mesh, map: &Map, (a, axis): Edge, coloured: bool) {
    let along = IVec3::AXES[axis];
    let b = a + along;
    let (da, db) = (distance(map.distance(a)), distance(map.distance(b)));
    // Where the line between both distances is zero.
    let t = da / (da - db);
    let position = (a.as_dvec3() + t * along.as_dvec3()) * f64::from(map.voxel_size_m);
    let normal = gradient(map, a).lerp(gradient(map, b), t);
    mesh.positions.push(position.as_vec3());
    mesh.normals.push(normal.normalize_or(along.as_dvec3() * (db - da).signum()).as_vec3());
    mesh.weights.push(map.distance(a).weight().min(map.distance(b).weight()));
    if coloured {
        mesh.colours.push(mixed_colour(map, a, b, t));
    }
}

/// The distance from the fixed-point number, without single precision's rounding.
fn distance(voxel: DistanceVoxel) -> f64 {
    1.0 - f64::from(voxel.0 & 0xffff) / 32767.5
}

/// Gradient of the distance at a voxel that was seen: central differences, one-sided ones where a neighbour was not seen,
/// zero where neither was.
fn gradient(map: &Map, voxel: IVec3) -> DVec3 {
    let seen = |at: IVec3| Some(map.distance(at)).filter(|v| v.weight() > 0).map(distance);
    let here = distance(map.distance(voxel));
    let slopes = IVec3::AXES.map(|axis| match (seen(voxel - axis), seen(voxel + axis)) {
        (Some(below), Some(above)) => 0.5 * (above - below),
        (None, Some(above)) => above - here,
        (Some(below), None) => here - below,
        (None, None) => 0.0,
    });
    DVec3::from_array(slopes)
}

/// The colour at `t` between two voxels; of one alone where the other holds none, black where neither does.
fn mixed_colour(map: &Map, a: IVec3, b: IVec3, t: f64) -> [u8; 3] {
    let (a, b) = (map.colour(a), map.colour(b));
    match (a.weight() > 0, b.weight() > 0) {
        (true, true) => std::array::from_fn(|i| {
            let (a, b) = (f64::from(a.rgb()[i]), f64::from(b.rgb()[i]));
            (a + t * (b - a)).round() as u8
        }),
        (true, false) => a.rgb(),
        (false, true) => b.rgb(),
        (false, false) => [0; 3],
    }
}
