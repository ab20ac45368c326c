//! Stage `mesh`: against its reference on random voxels, and against shapes whose surface is known.

mod common;

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use itm_core::Mesh;
use itm_core::voxel::{BlockKey, ColourVoxel, DistanceKind, DistanceVoxel, VoxelKind};
use itm_gpu::mesh::{Extract, Options};
use itm_gpu::reference::{self, Block, Map};
use itm_gpu::{BlockMap, Device, HostBlock, MapLayout};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

/// A power of two, so that vertices keep exactly which edge of the lattice they lie on.
const VOXEL_M: f32 = 1.0 / 128.0;
const BAND_VOXELS: f32 = 5.0;

/// Uploads a reference map.
fn upload(device: &Device, map: &Map, colour: bool) -> BlockMap {
    upload_as(device, map, VoxelKind { colour, ..VoxelKind::default() })
}

/// Uploads a reference map with voxels of a kind.
fn upload_as(device: &Device, map: &Map, kind: VoxelKind) -> BlockMap {
    let layout = MapLayout { voxel_size_m: map.voxel_size_m, truncation_m: map.truncation_m, kind };
    let mut uploaded = BlockMap::new(device, layout, 1).expect("a small map fits");
    let words: Vec<_> =
        map.positions().into_iter().map(|position| (position, map.blocks[&position].to_words(kind))).collect();
    let blocks: Vec<_> = words
        .iter()
        .map(|(position, words)| HostBlock { key: BlockKey { submap: 0, position: *position }, words })
        .collect();
    // In two calls, the second of which has to keep what the first one brought.
    let (some, others) = blocks.split_at(blocks.len() / 3);
    uploaded.insert_blocks(some).expect("a small map fits");
    uploaded.insert_blocks(others).expect("a small map fits");
    uploaded
}

fn mesh_of(device: &Device, map: &BlockMap, options: &Options) -> Mesh {
    Extract::new(device).run(map, options, &mut |_, _| ()).expect("the device answers")
}

/// A signed distance in voxels, positive outside, as a map of the blocks that its truncation band touches.
fn sampled(distance: impl Fn(Vec3) -> f32, reach_blocks: i32) -> Map {
    let mut map = Map::new(VOXEL_M, BAND_VOXELS * VOXEL_M);
    let side = -reach_blocks..reach_blocks;
    for (x, y, z) in side.clone().flat_map(|z| side.clone().map(move |y| (y, z))).flat_map(|(y, z)| {
        let side = -reach_blocks..reach_blocks;
        side.map(move |x| (x, y, z))
    }) {
        let position = IVec3::new(x, y, z);
        // A block's voxels lie within 6.1 of its middle.
        if distance((position * 8).as_vec3() + 3.5).abs() > BAND_VOXELS + 6.1 {
            continue;
        }
        let mut block = Block::default();
        for (i, voxel) in (0..).zip(&mut block.distances) {
            let at = (position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6)).as_vec3();
            *voxel = DistanceVoxel::new(distance(at) / BAND_VOXELS, 7);
        }
        map.blocks.insert(position, block);
    }
    map
}

fn sphere(centre: Vec3, radius: f32) -> impl Fn(Vec3) -> f32 {
    move |p| p.distance(centre) - radius
}

/// Each directed edge of the triangles occurs once, and so does its opposite.
fn assert_watertight(mesh: &Mesh) {
    let mut passes: HashMap<(u32, u32), usize> = HashMap::new();
    for t in &mesh.triangles {
        for i in 0..3 {
            *passes.entry((t[i], t[(i + 1) % 3])).or_default() += 1;
        }
    }
    let bad = passes.iter().filter(|((a, b), n)| **n != 1 || passes.get(&(*b, *a)) != Some(&1)).count();
    assert_eq!(bad, 0, "of {} edges, so many do not join two triangles", passes.len());
}

fn signed_volume(mesh: &Mesh) -> f64 {
    let corner = |i: u32| mesh.positions[i as usize].as_dvec3();
    mesh.triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0).sum()
}

/// Farthest vertex from the surface in voxels, and largest angle between normal and gradient in degrees.
fn worst_errors(mesh: &Mesh, distance: impl Fn(Vec3) -> f32) -> (f32, f32) {
    let gradient = |p: Vec3| {
        let slope = |axis: Vec3| distance(p + 0.01 * axis) - distance(p - 0.01 * axis);
        Vec3::new(slope(Vec3::X), slope(Vec3::Y), slope(Vec3::Z))
    };
    mesh.positions.iter().zip(&mesh.normals).fold((0.0, 0.0), |(farthest, widest): (f32, f32), (p, n)| {
        let p = *p / VOXEL_M;
        assert!((n.length() - 1.0).abs() < 1e-5);
        (farthest.max(distance(p).abs()), widest.max(gradient(p).angle_between(*n).to_degrees()))
    })
}

#[test]
fn a_sphere_over_many_blocks_is_watertight_true_and_faces_outward() {
    let Some(device) = common::device() else { return };
    let radius = 30.3;
    let shape = sphere(Vec3::new(0.4, -1.3, 2.2), radius);
    let map = upload(device, &sampled(&shape, 6), false);
    let mesh = mesh_of(device, &map, &Options::default());
    assert_watertight(&mesh);
    // A sphere: V - E + F = 2 with 3 F = 2 E.
    assert_eq!(mesh.positions.len() * 2, mesh.triangles.len() + 4);
    let (farthest, widest) = worst_errors(&mesh, &shape);
    // Along an edge the distance bends by at most 1 / radius a voxel squared.
    assert!(farthest < 0.125 / radius * 2.0, "{farthest} voxels from the sphere");
    assert!(widest < 2.0, "a normal is {widest} degrees off");
    let sphere_volume = 4.0 / 3.0 * std::f64::consts::PI * f64::from(radius * VOXEL_M).powi(3);
    assert!((signed_volume(&mesh) / sphere_volume - 1.0).abs() < 2e-3);
    assert!(mesh.weights.iter().all(|w| *w == 7) && mesh.colours.is_empty());
}

#[test]
fn the_size_of_the_ranges_does_not_change_the_mesh() {
    let Some(device) = common::device() else { return };
    let map = upload(device, &sampled(sphere(Vec3::splat(0.7), 20.0), 4), false);
    let whole = mesh_of(device, &map, &Options::default());
    for blocks_per_range in [0, 1, 7] {
        let mut told = Vec::new();
        let options = Options { blocks_per_range, ..Options::default() };
        let mesh = Extract::new(device).run(&map, &options, &mut |done, of| told.push((done, of))).unwrap();
        assert_eq!(mesh, whole);
        assert!(told.is_sorted() && told.last().is_some_and(|(done, of)| done == of), "{told:?}");
    }
}

#[test]
fn a_box_is_watertight_and_true_away_from_its_edges() {
    let Some(device) = common::device() else { return };
    let half = Vec3::new(17.25, 11.5, 9.75);
    let shape = |p: Vec3| {
        let q = p.abs() - half;
        q.max(Vec3::ZERO).length() + q.max_element().min(0.0)
    };
    let mesh = mesh_of(device, &upload(device, &sampled(shape, 4), false), &Options::default());
    assert_watertight(&mesh);
    assert!(signed_volume(&mesh) > 0.0);
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        let q = (*p / VOXEL_M).abs() - half;
        let near_face = (q + 3.0).max(Vec3::ZERO);
        // On the middle of a face only one axis comes near.
        if near_face.cmpgt(Vec3::ZERO).bitmask().count_ones() == 1 {
            assert!(shape(*p / VOXEL_M).abs() < 1e-3);
            assert!(n.abs().max_element() > 0.9999, "{n}");
        }
    }
}

#[test]
fn a_plane_that_ends_where_nothing_was_seen_has_true_normals_up_to_its_rim() {
    let Some(device) = common::device() else { return };
    let normal = Vec3::new(0.3, -0.5, 0.8).normalize();
    let shape = move |p: Vec3| p.dot(normal) - 1.7;
    let mesh = mesh_of(device, &upload(device, &sampled(shape, 3), false), &Options::default());
    let (farthest, widest) = worst_errors(&mesh, shape);
    assert!(mesh.triangles.len() > 1000);
    assert!(farthest < 1e-3 && widest < 0.1, "{farthest} voxels, {widest} degrees");
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        assert!((b - a).cross(c - a).dot(normal) > -1e-9);
    }
}

#[test]
fn a_map_of_several_pages_is_meshed_without_a_seam() {
    let Some(_) = common::device() else { return };
    let device = &common::device_with_bindings_of(16 << 20);
    let shape = sphere(Vec3::splat(0.3), 150.0);
    let map = upload(device, &sampled(&shape, 20), false);
    let blocks = map.read_record().unwrap().blocks;
    assert!(blocks > 1 << device.capabilities().page_shift(VoxelKind::default()), "{blocks} blocks fit one page");
    let mesh = mesh_of(device, &map, &Options::default());
    assert_watertight(&mesh);
    assert_eq!(mesh.positions.len() * 2, mesh.triangles.len() + 4);
    assert!(worst_errors(&mesh, &shape).0 < 0.01);
}

#[test]
fn an_empty_map_has_an_empty_mesh() {
    let Some(device) = common::device() else { return };
    let map = upload(device, &Map::new(VOXEL_M, 0.04), true);
    assert_eq!(mesh_of(device, &map, &Options::default()), Mesh::default());
}

#[test]
fn removed_blocks_leave_a_hole_and_nothing_else() {
    let Some(device) = common::device() else { return };
    let mut on_host = sampled(sphere(Vec3::ZERO, 15.0), 3);
    let map = upload(device, &on_host, false);
    let removed: Vec<IVec3> = on_host.positions().into_iter().step_by(5).collect();
    let hash = itm_gpu::hash::Hash::new(device);
    let keys: Vec<_> = removed.iter().map(|&position| BlockKey { submap: 0, position }).collect();
    let indices: Vec<u32> = hash.look_up(&map, &keys).unwrap().into_iter().map(Option::unwrap).collect();
    let mut recorder = itm_gpu::Recorder::new(device);
    hash.remove(&mut recorder, &map, &indices);
    let _untimed = recorder.submit();
    on_host.blocks.retain(|position, _| !removed.contains(position));
    let mesh = mesh_of(device, &map, &Options::default());
    assert!(!mesh.is_empty());
    assert_same(&mesh, &reference::mesh::extract(&on_host, 1, false));
}

/// A vertex by its edge of the lattice: the one coordinate that is no whole voxel names the axis.
fn edge_of(position: Vec3) -> ([i32; 3], usize) {
    let p = position / VOXEL_M;
    let whole: Vec<bool> = p.to_array().iter().map(|c| c.fract() == 0.0).collect();
    assert_eq!(whole.iter().filter(|w| **w).count(), 2, "{p} does not lie within an edge of the lattice");
    (p.floor().as_ivec3().to_array(), whole.iter().position(|w| !w).expect("one of three"))
}

/// A mesh as sorted triangles of edges, each starting with its smallest, and its vertices by edge.
type Canonical = (Vec<[([i32; 3], usize); 3]>, Vec<(([i32; 3], usize), usize)>);

fn canonical(mesh: &Mesh) -> Canonical {
    let edges: Vec<_> = mesh.positions.iter().map(|p| edge_of(*p)).collect();
    let mut triangles: Vec<_> = mesh
        .triangles
        .iter()
        .map(|t| {
            let mut t = t.map(|i| edges[i as usize]);
            let smallest = (0..3).min_by_key(|i| t[*i]).expect("three vertices");
            t.rotate_left(smallest);
            t
        })
        .collect();
    triangles.sort_unstable();
    let mut vertices: Vec<_> = edges.into_iter().zip(0..).collect();
    vertices.sort_unstable();
    (triangles, vertices)
}

fn assert_same(mesh: &Mesh, expected: &Mesh) {
    let ((triangles, vertices), (expected_triangles, expected_vertices)) = (canonical(mesh), canonical(expected));
    assert_eq!(triangles, expected_triangles);
    assert_eq!(vertices.len(), expected_vertices.len());
    assert_eq!(mesh.colours.len(), expected.colours.len());
    for ((edge, i), (expected_edge, j)) in vertices.into_iter().zip(expected_vertices) {
        assert_eq!(edge, expected_edge);
        assert!(mesh.positions[i].distance(expected.positions[j]) < 1e-6, "{edge:?}");
        assert!(mesh.normals[i].distance(expected.normals[j]) < 1e-3, "{edge:?}");
        assert_eq!(mesh.weights[i], expected.weights[j]);
        if let (Some(a), Some(b)) = (mesh.colours.get(i), expected.colours.get(j)) {
            assert!((0..3).all(|k| a[k].abs_diff(b[k]) <= 1), "{a:?} instead of {b:?} at {edge:?}");
        }
    }
}

/// Random voxels in some of the blocks around the origin: distances that are zero now and then, weights around the
/// smallest that counts, colours that are missing now and then.
fn random_map(seed: u64) -> Map {
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut map = Map::new(VOXEL_M, BAND_VOXELS * VOXEL_M);
    for i in 0..64 {
        if random.random_bool(0.4) {
            continue;
        }
        let mut block = Block::default();
        for voxel in &mut block.distances {
            let distance = if random.random_bool(0.1) { 0.0 } else { random.random_range(-1.0..1.0) };
            let weight =
                if random.random_bool(0.03) { random.random_range(0..3) } else { random.random_range(3..=u16::MAX) };
            *voxel = DistanceVoxel::new(distance, weight);
        }
        for colour in &mut block.colours {
            let weight = if random.random_bool(0.2) { 0 } else { random.random_range(1..=255) };
            *colour = ColourVoxel::new(random.random(), weight);
        }
        map.blocks.insert(IVec3::new(i & 3, i >> 2 & 3, i >> 4) - 2, block);
    }
    map
}

proptest! {
    #![proptest_config(common::cases(8))]

    #[test]
    fn random_voxels_give_the_references_mesh(seed: u64, min_weight in 0u16..4, colour: bool, f32: bool) {
        let Some(device) = common::device() else { return Ok(()) };
        let on_host = random_map(seed);
        let expected = reference::mesh::extract(&on_host, min_weight, colour);
        let options = Options { min_weight: min_weight.into(), blocks_per_range: 10, ..Options::default() };
        let distance = if f32 { DistanceKind::F32 } else { DistanceKind::I16 };
        let map = upload_as(device, &on_host, VoxelKind { distance, colour, confidence: false });
        assert_same(&mesh_of(device, &map, &options), &expected);
    }
}
