//! Stage `query` on the device: against its reference on random maps, and against distances known in closed form.

mod common;

use glam::{IVec3, Vec3};
use itm_core::sample::{Cell, Sample};
use itm_core::voxel::{BLOCK_VOXELS, BlockKey, DistanceKind, DistanceVoxel, VoxelKind};
use itm_gpu::query::Query;
use itm_gpu::{BlockMap, Device, HostBlock, MapLayout, reference};
use proptest::prelude::*;
use rand::SeedableRng as _;

type Distance<'a> = &'a dyn Fn(Vec3) -> f32;
type Slope<'a> = &'a dyn Fn(Vec3) -> Vec3;

/// Positions carry a few roundings of single precision; in voxels, up to a thousand from the origin.
const MARGIN: f64 = 1e-3;

/// A map on the device with a reference's blocks.
fn upload(device: &Device, map: &reference::Map, kind: VoxelKind) -> BlockMap {
    let layout = MapLayout { voxel_size_m: map.voxel_size_m, truncation_m: map.truncation_m, kind };
    let mut uploaded = BlockMap::new(device, layout, 1).expect("a small map fits");
    let words: Vec<_> = map.positions().into_iter().map(|p| (p, map.blocks[&p].to_words(kind))).collect();
    let blocks: Vec<_> = words
        .iter()
        .map(|(position, words)| HostBlock { key: BlockKey { submap: 0, position: *position }, words })
        .collect();
    uploaded.insert_blocks(&blocks).expect("they fit");
    uploaded
}

/// Blocks in a cube around the origin, some of which are not there, filled with a function of the voxel.
fn blocks(
    reach: i32,
    mut there: impl FnMut(IVec3) -> bool,
    mut voxel: impl FnMut(IVec3) -> DistanceVoxel,
) -> Vec<(IVec3, reference::Block)> {
    let side = || -reach..reach;
    let all = side().flat_map(|z| side().flat_map(move |y| side().map(move |x| IVec3::new(x, y, z))));
    let mut found = Vec::new();
    for position in all.filter(|position| there(*position)) {
        let mut block = reference::Block::default();
        for i in 0..BLOCK_VOXELS as i32 {
            block.distances[i as usize] = voxel(position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6));
        }
        found.push((position, block));
    }
    found
}

fn kind(float: bool) -> VoxelKind {
    VoxelKind { distance: if float { DistanceKind::F32 } else { DistanceKind::I16 }, ..VoxelKind::default() }
}

fn compare(map: &reference::Map, points: &[Vec3], found: &[Option<Sample>]) -> Result<usize, TestCaseError> {
    let mut seen = 0;
    for (point, found) in points.iter().zip(found) {
        let Some(cell) = Cell::around(*point, map.voxel_size_m) else {
            prop_assert!(found.is_none());
            continue;
        };
        // On a border between cells either may answer.
        if cell.fraction.min_element() < MARGIN || cell.fraction.max_element() > 1.0 - MARGIN {
            continue;
        }
        match (reference::query::sample(map, *point), found) {
            (None, None) => {}
            (Some(a), Some(b)) => {
                seen += 1;
                // Neighbouring voxels differ by up to two bands, and so do slopes.
                let tolerance = 8.0 * MARGIN as f32 * map.truncation_m;
                prop_assert!((a.distance_m - b.distance_m).abs() <= tolerance, "{a:?} {b:?}");
                prop_assert!((a.gradient - b.gradient).length() <= 2.0 * tolerance / map.voxel_size_m, "{a:?} {b:?}");
            }
            (a, b) => prop_assert!(false, "{a:?} {b:?} at {point}"),
        }
    }
    Ok(seen)
}

proptest! {
    #![proptest_config(common::cases(16))]

    #[test]
    fn random_maps_answer_as_the_reference_does(seed: u64, float: bool, voxel_size_m in 0.005f32..0.1, gaps in 0.0..0.2) {
        let Some(device) = common::device() else { return Ok(()) };
        let mut random = rand_pcg::Pcg32::seed_from_u64(seed);
        let mut map = reference::Map::new(voxel_size_m, 4.0 * voxel_size_m);
        let mut other = random.clone();
        map.blocks.extend(blocks(3, |_| other.random_bool(0.8), |_| {
            let weight = u16::from(!random.random_bool(gaps * 0.1));
            DistanceVoxel::new(random.random_range(-1.0..=1.0), weight)
        }));
        let uploaded = upload(device, &map, kind(float));
        let reach = 26.0 * voxel_size_m;
        let mut points: Vec<_> =
            (0..2000).map(|_| Vec3::from_array(std::array::from_fn(|_| random.random_range(-reach..reach)))).collect();
        points.extend([Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e20), Vec3::splat(40_000.0)]);
        let found = Query::new(device).run(&uploaded, &points).unwrap();
        prop_assert_eq!(found.len(), points.len());
        let seen = compare(&map, &points, &found)?;
        prop_assert!(seen > 50, "{} points were seen", seen);
    }
}

#[test]
fn the_distances_of_a_plane_and_a_sphere_are_exact_to_a_hundredth_of_a_voxel() {
    let Some(device) = common::device() else { return };
    let voxel_size_m = 0.01_f32;
    let band = 5.0_f32;
    let normal = Vec3::new(0.36, -0.48, 0.8);
    let centre = Vec3::new(1.3, -2.4, 0.7);
    // In voxels.
    let plane = |p: Vec3| normal.dot(p) - 3.2;
    let sphere = |p: Vec3| p.distance(centre) - 60.0;
    let shapes: [(i32, Distance<'_>, Slope<'_>); 2] =
        [(3, &plane, &|_| normal), (9, &sphere, &|p| (p - centre).normalize())];
    for ((reach, distance, slope), float) in shapes.into_iter().flat_map(|s| [(s, false), (s, true)]) {
        let mut map = reference::Map::new(voxel_size_m, band * voxel_size_m);
        let near = |position: IVec3| distance((position * 8).as_vec3() + 3.5).abs() < band + 6.1;
        map.blocks.extend(blocks(reach, near, |v| DistanceVoxel::new(distance(v.as_vec3()) / band, 1)));
        let uploaded = upload(device, &map, kind(float));
        let mut random = rand_pcg::Pcg32::seed_from_u64(7);
        let points: Vec<Vec3> = (0..200_000)
            .map(|_| Vec3::from_array(std::array::from_fn(|_| random.random_range(-8.0..8.0) * reach as f32)))
            .filter(|p| distance(*p).abs() < band - 1.8)
            .collect();
        let metres: Vec<_> = points.iter().map(|p| *p * voxel_size_m).collect();
        let found = Query::new(device).run(&uploaded, &metres).unwrap();
        let mut seen = 0;
        for (point, found) in points.iter().zip(found) {
            // At the edges of the cube of blocks.
            let Some(found) = found else { continue };
            seen += 1;
            let off = found.distance_m / voxel_size_m - distance(*point);
            assert!(off.abs() < 0.01, "{off} voxels off at {point}");
            let degrees = found.gradient.angle_between(slope(*point)).to_degrees();
            assert!(degrees < 1.0, "{degrees} degrees off at {point}");
            assert!((found.gradient.length() - 1.0).abs() < 0.02);
        }
        assert!(seen > points.len() / 2 && seen > 1000, "{seen} of {}", points.len());
    }
}

#[test]
fn what_lies_beyond_the_band_is_truncated_and_an_empty_map_knows_nothing() {
    let Some(device) = common::device() else { return };
    let mut map = reference::Map::new(0.01, 0.04);
    map.blocks.extend(blocks(2, |_| true, |v| DistanceVoxel::new(v.x as f32 / 4.0, 1)));
    let uploaded = upload(device, &map, VoxelKind::default());
    let query = Query::new(device);
    let points = [Vec3::new(0.08, 0.0, 0.0), Vec3::new(-0.1, 0.01, 0.02), Vec3::new(0.3, 0.0, 0.0)];
    let found = query.run(&uploaded, &points).unwrap();
    assert_eq!(found[0], Some(Sample { distance_m: 0.04, gradient: Vec3::ZERO }));
    assert_eq!(found[1], Some(Sample { distance_m: -0.04, gradient: Vec3::ZERO }));
    assert_eq!(found[2], None);
    let empty = BlockMap::new(device, *uploaded.layout(), 1).unwrap();
    assert_eq!(query.run(&empty, &points).unwrap(), [None; 3]);
    assert_eq!(query.run(&empty, &[]).unwrap(), []);
}

#[test]
fn a_map_in_several_pages_answers_the_same() {
    if common::device().is_none() {
        return;
    }
    let paged = common::device_with_bindings_of(16 << 20);
    let mut random = rand_pcg::Pcg32::seed_from_u64(3);
    let mut map = reference::Map::new(0.01, 0.04);
    // 5832 blocks, 4096 a page.
    map.blocks.extend(blocks(9, |_| true, |_| DistanceVoxel::new(random.random_range(-1.0..=1.0), 1)));
    let uploaded = upload(&paged, &map, kind(true));
    let points: Vec<_> =
        (0..20_000).map(|_| Vec3::from_array(std::array::from_fn(|_| random.random_range(-0.7..0.7)))).collect();
    let found = Query::new(&paged).run(&uploaded, &points).unwrap();
    assert!(compare(&map, &points, &found).unwrap() > 15_000);
}
