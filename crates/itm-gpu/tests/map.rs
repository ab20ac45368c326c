//! Stages `allocate`, `visible`, `integrate` and `hash` on the device, against their references and against scenes whose
//! truth is known.

mod common;

use std::collections::HashSet;

use common::{Fusion, Gpu, OPTIONS, Scene, Shape};
use glam::{DVec3, IVec3};
use itm_core::voxel::{BLOCK_VOXELS, BlockKey, DistanceKind, DistanceVoxel, VoxelKind};
use itm_core::{Calibration, DepthConversion, Frame, Image, Intrinsics, Se3};
use itm_gpu::integrate::IntegrateOptions;
use itm_gpu::{HostBlock, Recorder, View, reference};
use proptest::prelude::*;

/// Positions along a ray of up to 5 m carry a few roundings of 2.4e-7 m each; in blocks of 8 cm and more that is less than
/// this share of their edge.
const BLOCK_MARGIN: f64 = 2e-5;
/// The same in metres.
const MARGIN_M: f64 = 2e-6;
/// The same in pixels, for focal lengths of up to 100 pixels and depths of 0.2 m and more.
const MARGIN_PX: f64 = 1e-3;

fn size() -> impl Strategy<Value = (u32, u32)> {
    prop_oneof![Just((1, 1)), Just((81, 61)), Just((64, 48)), (1..90u32, 1..70u32)]
}

fn pose() -> impl Strategy<Value = Se3> {
    let (t, r) = (-0.3..0.3, -0.6..0.6);
    [t.clone(), t.clone(), t, r.clone(), r.clone(), r].prop_map(Se3::exp)
}

/// The room as seen from a pose, with holes and a centimetre of noise.
fn noisy_room(camera: &Intrinsics, world_from_camera: &Se3, seed: u32) -> Image<f32> {
    let depth = Scene::room().depth(camera, world_from_camera);
    Image::from_fn(camera.width, camera.height, |x, y| {
        let hash = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed).wrapping_mul(0xc2b2_ae35) >> 8;
        if hash.is_multiple_of(13) { 0.0 } else { depth[(x, y)] + (hash % 1000) as f32 * 1e-5 }
    })
}

fn positions(keys: &[BlockKey]) -> Vec<IVec3> {
    keys.iter().map(|k| k.position).collect()
}

fn key(position: IVec3) -> BlockKey {
    BlockKey { submap: 0, position }
}

proptest! {
    #![proptest_config(common::cases(12))]

    #[test]
    fn the_blocks_that_depth_asks_for_are_there_and_numbered_by_place(
        size in size(), pose in pose(), seed: u32, voxel_size_m in 0.01f32..0.05,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let mut fusion = Fusion::new(gpu, camera, voxel_size_m, false, 20_000);
        let frame = common::frame(noisy_room(&camera, &pose, seed), None);
        let record = fusion.allocate(gpu, &frame, &pose);
        let keys = fusion.keys();
        prop_assert_eq!(record.allocated as usize, keys.len());
        prop_assert_eq!((record.requested, record.pending, record.dropped), (record.allocated, 0, 0));

        let map = reference::Map::new(voxel_size_m, 4.0 * voxel_size_m);
        let depth = fusion.view.read_depth(&gpu.device, 0).unwrap();
        let found: HashSet<IVec3> = keys.iter().map(|k| k.position).collect();
        prop_assert_eq!(found.len(), keys.len(), "no block twice");
        // Blocks that a ray crosses by less than the margin may be there or not.
        let surely = reference::allocate::requested(&map, &depth, &camera, &pose, -BLOCK_MARGIN);
        let perhaps = reference::allocate::requested(&map, &depth, &camera, &pose, BLOCK_MARGIN);
        prop_assert!(surely.is_subset(&found), "missing {:?}", surely.difference(&found).collect::<Vec<_>>());
        prop_assert!(found.is_subset(&perhaps), "not asked for {:?}", found.difference(&perhaps).collect::<Vec<_>>());

        // Block indices follow the grid's cells.
        let cells: Vec<_> = keys.iter().map(|k| (k.position.z, k.position.y, k.position.x)).collect();
        prop_assert!(cells.is_sorted());

        // The same frame asks for nothing more.
        let again = fusion.allocate(gpu, &frame, &pose);
        prop_assert_eq!((again.requested, again.allocated, again.blocks), (0, 0, record.blocks));
        prop_assert_eq!(fusion.keys(), keys);
    }

    #[test]
    fn visible_blocks_are_those_in_the_frustum_in_the_order_of_their_indices(
        size in size(), fused_from in pose(), seen_from in pose(), seed: u32, negative_fy: bool, far_m in 0.5f32..4.0,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let mut fusion = Fusion::new(gpu, common::camera(80, 60), 0.03, false, 8_000);
        let frame = common::frame(noisy_room(&common::camera(80, 60), &fused_from, seed), None);
        fusion.allocate(gpu, &frame, &fused_from);
        let keys = fusion.keys();
        let camera = if negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera };
        let range_m = [0.4, far_m];

        let mut recorder = Recorder::new(&gpu.device);
        gpu.visible.record(&mut recorder, &fusion.map, &camera, &seen_from, range_m[0], range_m[1]);
        let _untimed = recorder.submit();
        let visible = fusion.visible(gpu);
        prop_assert!(visible.is_sorted_by(|a, b| a < b));
        let visible: HashSet<u32> = visible.into_iter().collect();
        let map = reference::Map::new(0.03, 0.12);
        for (key, index) in keys.iter().zip(0..) {
            let expected = |margin_m| {
                reference::visible::is_visible(&map, key.position, &camera, &seen_from, range_m, margin_m)
            };
            if visible.contains(&index) {
                prop_assert!(expected(MARGIN_M), "{} is listed", key.position);
            } else {
                prop_assert!(!expected(-MARGIN_M), "{} is not listed", key.position);
            }
        }
    }

    #[test]
    fn observations_are_fused_as_the_reference_does(
        size in size(),
        seed: u32,
        poses in [pose(), pose(), pose()],
        colour: bool,
        max_weight in prop_oneof![Just(1u16), Just(2), Just(100), Just(65_535)],
        stop_at_max_weight: bool,
        shifted_colour: bool,
        gaps: bool,
        (weighted, confidence, f32) in any::<(bool, bool, bool)>(),
        empty_loss in prop_oneof![Just(0u16), Just(1), Just(100)],
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let depth_camera = common::camera(size.0, size.1);
        let calibration = if shifted_colour {
            Calibration {
                colour: common::camera(97, 71),
                colour_from_depth: Se3::exp([0.03, -0.01, 0.005, 0.01, 0.02, -0.03]),
                ..Calibration::registered(depth_camera, DepthConversion::MILLIMETRES)
            }
        } else {
            Calibration::registered(depth_camera, DepthConversion::MILLIMETRES)
        };
        let distance = if f32 { DistanceKind::F32 } else { DistanceKind::I16 };
        let kind = VoxelKind { distance, colour: true, confidence };
        let mut fusion = Fusion::of_kind(gpu, calibration, 0.04, kind, 4_000);
        fusion.options = IntegrateOptions { max_weight, stop_at_max_weight, empty_loss, weighted, ..OPTIONS };
        if weighted {
            fusion.view_options.observation_weights = true;
            fusion.view = View::new(&gpu.device, &calibration, &fusion.view_options);
        }
        for (pose, i) in poses.iter().zip(0..) {
            // One frame without colour among those with.
            let image = (colour && i != 1).then(|| {
                let mut image = common::colours(&calibration.colour);
                // Every seventh pixel has no colour.
                image.data_mut().iter_mut().step_by(7).for_each(|pixel| pixel[3] = if gaps { 0 } else { 255 });
                image
            });
            let frame = common::frame(noisy_room(&depth_camera, pose, seed ^ i), image);
            fusion.allocate(gpu, &frame, pose);
            // From what the device held before, so that differences do not add up over the frames.
            let mut expected = fusion.read();
            fusion.integrate(gpu, pose);
            let found = fusion.read();
            let keys = fusion.keys();
            let visible: Vec<IVec3> = fusion.visible(gpu).iter().map(|i| keys[*i as usize].position).collect();
            let depth = fusion.view.read_depth(&gpu.device, 0).unwrap();
            let weights = fusion.view.read_observations(&gpu.device).unwrap().map(|observations| {
                Image::from_fn(observations.width(), observations.height(), |x, y| observations[(x, y)][1] as u16)
            });
            prop_assert_eq!(weights.is_some(), weighted || confidence);
            let observation = reference::integrate::Observation {
                depth: &depth,
                weights: weights.as_ref(),
                colour: frame.colour.as_ref(),
                calibration: &calibration,
                world_from_camera: pose,
            };
            reference::integrate::integrate(&mut expected, &visible, &observation, &fusion.options);
            if !confidence {
                expected.blocks.values_mut().for_each(|block| block.confidences = [0.0; BLOCK_VOXELS]);
            }
            compare_voxels(&found, &expected, &observation)?;
        }
    }
}

/// Voxel by voxel. Only where the reference says that a voxel lies on a border of pixels or of the truncation band may the
/// device take the other side.
fn compare_voxels(
    found: &reference::Map,
    expected: &reference::Map,
    observation: &reference::integrate::Observation<'_>,
) -> Result<(), TestCaseError> {
    // Half a step of rounding on either side, and the margin of positions as a share of the band.
    let steps = 1 + (MARGIN_M / f64::from(found.truncation_m) * 32767.5).ceil() as i32;
    let (mut voxels, mut on_borders) = (0, 0);
    for position in expected.positions() {
        let (a, b) = (&found.blocks[&position], &expected.blocks[&position]);
        for i in 0..BLOCK_VOXELS {
            voxels += i32::from(b.distances[i].weight() > 0);
            let same_distance = a.distances[i].weight() == b.distances[i].weight()
                && ((a.distances[i].0 & 0xffff) as i32).abs_diff((b.distances[i].0 & 0xffff) as i32) <= steps as u32;
            // A step of a byte: interpolated colours are rounded.
            let same_colour = a.colours[i].weight() == b.colours[i].weight()
                && (0..3).all(|c| a.colours[i].rgb()[c].abs_diff(b.colours[i].rgb()[c]) <= 1);
            let same_confidence = (a.confidences[i] - b.confidences[i]).abs() <= 1e-5 * b.confidences[i].max(1.0);
            if same_distance && same_colour && same_confidence {
                continue;
            }
            let world = reference::integrate::voxel_in_map(position, i).as_dvec3() * f64::from(found.voxel_size_m);
            let border = on_border(observation, world, f64::from(found.truncation_m), same_distance && same_confidence);
            prop_assert!(
                border,
                "voxel {i} of block {position}: {:?} {:?} but {:?} {:?}",
                a.distances[i],
                a.colours[i],
                b.distances[i],
                b.colours[i]
            );
            on_borders += 1;
        }
    }
    // Borders are thin: a thousandth of a pixel to either side.
    prop_assert!(on_borders <= 5 + voxels / 100, "{on_borders} of {voxels} voxels lie on borders");
    Ok(())
}

fn on_border(
    observation: &reference::integrate::Observation<'_>,
    world: DVec3,
    truncation_m: f64,
    colour_only: bool,
) -> bool {
    let calibration = observation.calibration;
    let gaps = observation.colour.is_some_and(|c| c.data().iter().any(|[.., alpha]| *alpha == 0));
    let near_integer = |v: f64| (v - v.round()).abs() < MARGIN_PX;
    let in_camera = observation.world_from_camera.inverse().transform_point(world);
    let between_pixels =
        calibration.depth.project(in_camera).is_some_and(|p| near_integer(p.x + 0.5) || near_integer(p.y + 0.5));
    let eta = reference::integrate::signed_distance(observation, world).map(|(_, eta)| eta);
    let band_ends = eta.is_some_and(|eta| (eta.abs() - truncation_m).abs() < MARGIN_M);
    let colour_ends = colour_only && {
        let band = truncation_m * f64::from(OPTIONS.colour_band);
        let last = |size: u32| f64::from(size) - 1.0;
        let pixel = calibration.colour.project(calibration.colour_from_depth.transform_point(in_camera));
        eta.is_some_and(|eta| (eta.abs() - band).abs() < MARGIN_M)
            || pixel.is_some_and(|p| {
                // Where there are pixels without colour, it counts between which four a point lies.
                (gaps && (near_integer(p.x) || near_integer(p.y)))
                    || p.x.abs() < MARGIN_PX
                    || p.y.abs() < MARGIN_PX
                    || (p.x - last(calibration.colour.width)).abs() < MARGIN_PX
                    || (p.y - last(calibration.colour.height)).abs() < MARGIN_PX
            })
    };
    between_pixels || band_ends || colour_ends
}

#[test]
fn a_wall_seen_head_on_has_exact_distances() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(80, 60);
    let scene = Scene(vec![Shape::Plane { normal: DVec3::Z, distance: 1.507 }]);
    let mut fusion = Fusion::new(gpu, camera, 0.02, false, 2_000);
    for _ in 0..3 {
        fusion.fuse(gpu, &common::frame(scene.depth(&camera, &Se3::IDENTITY), None), &Se3::IDENTITY);
    }
    let map = fusion.read();
    let (mut seen, mut never) = (0, 0);
    for position in map.positions() {
        for (i, voxel) in map.blocks[&position].distances.iter().enumerate() {
            let world = reference::integrate::voxel_in_map(position, i).as_dvec3() * 0.02;
            let truth = (1.507 - world.z) / 0.08;
            match voxel.weight() {
                0 => never += 1,
                3 => {
                    // Three times half a step of rounding, and 2.4e-7 m of single precision.
                    let error = (f64::from(voxel.distance()) - truth.min(1.0)).abs();
                    assert!(error < 1.5 / 32767.5 + 1e-5, "{world}: {error}");
                    assert!(truth >= -1.0 - 1e-5, "{world} lies behind the band");
                    seen += 1;
                }
                other => panic!("{world} was seen {other} times of three"),
            }
        }
    }
    assert!(seen > 20_000 && never > 1_000, "{seen} voxels seen, {never} not");
}

#[test]
fn colours_are_fused_near_the_surface_and_nowhere_else() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(80, 60);
    let scene = Scene(vec![Shape::Plane { normal: DVec3::Z, distance: 1.5 }]);
    let mut fusion = Fusion::new(gpu, camera, 0.02, true, 2_000);
    let image = Image::from_fn(80, 60, |x, _| if x < 40 { [250, 10, 0, 255] } else { [0, 20, 240, 255] });
    fusion.fuse(gpu, &common::frame(scene.depth(&camera, &Se3::IDENTITY), Some(image)), &Se3::IDENTITY);
    let map = fusion.read();
    let mut coloured = 0;
    for position in map.positions() {
        for (i, voxel) in map.blocks[&position].colours.iter().enumerate() {
            let world = reference::integrate::voxel_in_map(position, i).as_dvec3() * 0.02;
            if voxel.weight() == 0 {
                continue;
            }
            coloured += 1;
            assert!((world.z - 1.5).abs() <= 0.5 * 0.08 + 1e-6, "{world}");
            let pixel = camera.project(world).unwrap();
            if (pixel.x - 39.5).abs() > 0.5 {
                let expected = if pixel.x < 39.5 { [250, 10, 0] } else { [0, 20, 240] };
                assert_eq!(voxel.rgb(), expected, "{world}");
            }
        }
    }
    assert!(coloured > 5_000, "{coloured} voxels have a colour");
}

/// A frame that asks for thousands of blocks of 8 cm at once, and its pose.
fn large_request(width: u32, height: u32) -> (Intrinsics, Frame, Se3) {
    let camera = common::camera(width, height);
    let pose = common::poses()[0];
    (camera, common::frame(Scene::room().depth(&camera, &pose), None), pose)
}

#[test]
fn thousands_of_blocks_are_found_after_one_frame_and_others_are_not() {
    let Some(gpu) = common::gpu() else { return };
    let (camera, frame, pose) = large_request(160, 120);
    // As full as a hash gets: a block for every second slot.
    let probe = Fusion::new(gpu, camera, 0.01, false, 16_000).allocate(gpu, &frame, &pose);
    let mut fusion = Fusion::new(gpu, camera, 0.01, false, probe.blocks);
    let record = fusion.allocate(gpu, &frame, &pose);
    assert!(record.allocated > 2_000, "{record:?}");
    assert_eq!((record.allocated, record.pending), (record.requested, 0));
    let keys = fusion.keys();
    let slots = (2 * fusion.map.capacity()).next_power_of_two();
    let wanted: HashSet<u32> = keys.iter().map(|k| reference::hash::hash_of(*k) & (slots - 1)).collect();
    assert!(wanted.len() < keys.len() * 9 / 10, "many keys want the slot of another");

    let found = gpu.hash.look_up(&fusion.map, &keys).unwrap();
    let expected: Vec<_> = (0..record.blocks).map(Some).collect();
    assert_eq!(found, expected);
    let there: HashSet<IVec3> = positions(&keys).into_iter().collect();
    let others: Vec<_> = (-8..8)
        .flat_map(|x| (-8..8).flat_map(move |y| (-8..8).map(move |z| IVec3::new(x * 3, y * 3, z * 3))))
        .filter(|p| !there.contains(p))
        .map(key)
        .chain(keys.iter().map(|k| BlockKey { submap: 1, ..*k }))
        .collect();
    assert!(gpu.hash.look_up(&fusion.map, &others).unwrap().iter().all(Option::is_none));
    assert_eq!(gpu.hash.look_up(&fusion.map, &[]).unwrap(), []);
}

#[test]
fn keys_that_all_want_the_last_few_slots_are_told_apart() {
    let Some(gpu) = common::gpu() else { return };
    // 512 blocks in 1024 slots, all of which want one of the last four: one long row that goes on at the beginning.
    let mut colliding = (0..)
        .map(|i: i32| {
            let position = IVec3::new(i % 64 - 32, i / 64 % 64 - 32, i / 4096 - 32);
            BlockKey { submap: (i % 3) as u16, position }
        })
        .filter(|key| reference::hash::hash_of(*key) & 1023 >= 1020);
    let keys: Vec<BlockKey> = colliding.by_ref().take(512).collect();
    let others: Vec<BlockKey> = colliding.take(100).collect();
    let mut fusion = Fusion::new(gpu, common::camera(8, 6), 0.02, false, 512);
    let voxels: Vec<_> = (0..512).map(|i| [DistanceVoxel::new(0.5, i).0; BLOCK_VOXELS]).collect();
    let blocks: Vec<_> = keys.iter().zip(&voxels).map(|(key, words)| HostBlock { key: *key, words }).collect();
    fusion.map.insert_blocks(&blocks).unwrap();
    assert_eq!(fusion.map.capacity(), 512);
    assert_eq!(fusion.map.read_block(300).unwrap(), voxels[300]);

    let find = |fusion: &Fusion, keys: &[BlockKey]| gpu.hash.look_up(&fusion.map, keys).unwrap();
    assert!(find(&fusion, &keys).into_iter().eq((0..512).map(Some)));
    assert!(find(&fusion, &others).iter().all(Option::is_none));

    let odd: Vec<u32> = (0..512).filter(|i| i % 2 == 1).collect();
    let mut recorder = Recorder::new(&gpu.device);
    gpu.hash.remove(&mut recorder, &fusion.map, &odd);
    let _untimed = recorder.submit();
    let left = || (0..512).map(|i| (i % 2 == 0).then_some(i));
    assert!(find(&fusion, &keys).into_iter().eq(left()), "found across tombstones");
    assert!(find(&fusion, &others).iter().all(Option::is_none));
    let mut recorder = Recorder::new(&gpu.device);
    gpu.hash.rebuild(&mut recorder, &fusion.map);
    let _untimed = recorder.submit();
    assert!(find(&fusion, &keys).into_iter().eq(left()), "found in a hash without tombstones");
    fusion.map.grow(3_000).unwrap();
    assert!(find(&fusion, &keys).into_iter().eq(left()), "found in a larger hash");
}

#[test]
fn removed_blocks_leave_and_their_memory_is_used_again() {
    let Some(gpu) = common::gpu() else { return };
    let (camera, frame, pose) = large_request(80, 60);
    let mut fusion = Fusion::new(gpu, camera, 0.02, true, 4_000);
    let first = fusion.fuse(gpu, &frame, &pose);
    let keys = fusion.keys();
    let before = fusion.read();
    // Two of three go, in an order of their own.
    let removed: Vec<u32> = (0..first.blocks).rev().filter(|i| i % 3 != 0).collect();
    let mut recorder = Recorder::new(&gpu.device);
    gpu.hash.remove(&mut recorder, &fusion.map, &removed);
    let _untimed = recorder.submit();

    let is_removed: HashSet<u32> = removed.iter().copied().collect();
    let expect_lookups = |fusion: &Fusion| {
        for (found, index) in gpu.hash.look_up(&fusion.map, &keys).unwrap().into_iter().zip(0..) {
            assert_eq!(found, (!is_removed.contains(&index)).then_some(index));
        }
    };
    expect_lookups(&fusion);
    let record = fusion.map.read_record().unwrap();
    assert_eq!(record.free_blocks as usize, removed.len());
    assert_eq!((record.blocks, record.tombstones), (first.blocks, record.free_blocks));
    for index in removed.iter().take(5) {
        assert!(fusion.map.read_block(*index).unwrap().iter().all(|v| *v == 0), "removed blocks are cleared");
    }

    // Those that stayed are found among tombstones, and in a hash without.
    let mut recorder = Recorder::new(&gpu.device);
    gpu.hash.rebuild(&mut recorder, &fusion.map);
    let _untimed = recorder.submit();
    expect_lookups(&fusion);
    assert_eq!(fusion.map.read_record().unwrap().tombstones, 0);
    let after = fusion.read();
    assert_eq!(after.blocks.len(), keys.len() - removed.len());
    for (position, block) in &after.blocks {
        assert_eq!(block, &before.blocks[position], "{position}");
    }

    // The same frame brings them back: the last one freed first, by place in the grid.
    let again = fusion.fuse(gpu, &frame, &pose);
    assert_eq!(again.allocated as usize, removed.len());
    assert_eq!((again.blocks, again.free_blocks), (first.blocks, 0));
    let now = fusion.keys();
    let mut missing: Vec<IVec3> = removed.iter().map(|i| keys[*i as usize].position).collect();
    missing.sort_by_key(|p| (p.z, p.y, p.x));
    for (index, position) in removed.iter().rev().zip(missing) {
        assert_eq!(now[*index as usize].position, position);
    }
    assert!(gpu.hash.look_up(&fusion.map, &now).unwrap().into_iter().eq((0..again.blocks).map(Some)));
}

#[test]
fn removing_and_allocating_over_and_over_neither_loses_nor_doubles_a_block() {
    let Some(gpu) = common::gpu() else { return };
    let (camera, frame, pose) = large_request(80, 60);
    let probe = Fusion::new(gpu, camera, 0.02, false, 4_000).allocate(gpu, &frame, &pose);
    let mut fusion = Fusion::new(gpu, camera, 0.02, false, probe.blocks);
    fusion.allocate(gpu, &frame, &pose);
    let expected: HashSet<IVec3> = positions(&fusion.keys()).into_iter().collect();
    for round in 0..6 {
        // The hash is rebuilt before its tombstones have taken every slot, as whoever removes must see to.
        let mut recorder = Recorder::new(&gpu.device);
        let removed: Vec<u32> = (0..probe.blocks).filter(|i| (i * 7 + round) % 4 == 0).collect();
        gpu.hash.remove(&mut recorder, &fusion.map, &removed);
        if round % 2 == 1 {
            gpu.hash.rebuild(&mut recorder, &fusion.map);
        }
        let _untimed = recorder.submit();
        let record = fusion.allocate(gpu, &frame, &pose);
        assert_eq!(record.allocated as usize, removed.len());
        let keys = fusion.keys();
        assert_eq!(positions(&keys).into_iter().collect::<HashSet<_>>(), expected);
        assert!(gpu.hash.look_up(&fusion.map, &keys).unwrap().into_iter().eq((0..probe.blocks).map(Some)));
    }
}

#[test]
fn growth_keeps_every_block_where_it_was() {
    let Some(gpu) = common::gpu() else { return };
    let (camera, frame, pose) = large_request(80, 60);
    let mut fusion = Fusion::new(gpu, camera, 0.02, true, 3_000);
    fusion.fuse(gpu, &frame, &pose);
    let (keys, before, visible) = (fusion.keys(), fusion.read(), fusion.visible(gpu));
    for capacity in [2_000, 3_001, 40_000] {
        fusion.map.grow(capacity).unwrap();
        assert_eq!(fusion.map.capacity(), capacity.max(3_000));
        assert_eq!(fusion.keys(), keys);
        assert_eq!(fusion.read(), before);
        assert_eq!(fusion.visible(gpu), visible);
        assert!(gpu.hash.look_up(&fusion.map, &keys).unwrap().into_iter().eq((0..keys.len() as u32).map(Some)));
    }
    let again = fusion.allocate(gpu, &frame, &pose);
    assert_eq!(again.requested, 0);
}

#[test]
fn requests_that_find_no_room_wait_for_it() {
    let Some(gpu) = common::gpu() else { return };
    let (camera, frame, pose) = large_request(80, 60);
    let mut roomy = Fusion::new(gpu, camera, 0.01, false, 8_000);
    let all = roomy.allocate(gpu, &frame, &pose).blocks;
    let expected: HashSet<IVec3> = positions(&roomy.keys()).into_iter().collect();

    let mut fusion = Fusion::new(gpu, camera, 0.01, false, 100);
    let full = fusion.allocate(gpu, &frame, &pose);
    assert_eq!((full.requested, full.allocated, full.blocks), (all, 100, 100));
    assert_eq!((full.pending, full.dropped), (all - 100, 0));
    assert_eq!(fusion.keys(), &roomy.keys()[..100], "the first by place in the grid");
    // The same frame again: what waits is not noted twice.
    let again = fusion.allocate(gpu, &frame, &pose);
    assert_eq!((again.requested, again.allocated, again.pending), (all - 100, 0, all - 100));

    // Frames without depth from here on: only what waits asks. From a place whose grid does not reach there, it goes on
    // waiting.
    let nothing = common::frame(Image::filled(80, 60, 0.0), None);
    fusion.map.grow(1_000).unwrap();
    let far_away = Se3::exp([100.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let elsewhere = fusion.allocate(gpu, &nothing, &far_away);
    assert_eq!((elsewhere.requested, elsewhere.pending), (0, all - 100));
    let partly = fusion.allocate(gpu, &nothing, &pose);
    assert_eq!((partly.requested, partly.allocated, partly.pending), (all - 100, 900, all - 1_000));
    fusion.map.grow(8_000).unwrap();
    let done = fusion.allocate(gpu, &nothing, &pose);
    assert_eq!((done.allocated, done.pending, done.blocks), (all - 1_000, 0, all));
    assert_eq!(positions(&fusion.keys()).into_iter().collect::<HashSet<_>>(), expected);
}

#[test]
fn two_runs_give_the_same_bytes() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(81, 61);
    let run = || {
        // A map that grows on the way, so that waiting blocks are among what must repeat.
        let mut fusion = Fusion::new(gpu, camera, 0.02, true, 600);
        for pose in common::poses() {
            let frame = common::frame(noisy_room(&camera, &pose, 7), Some(common::colours(&camera)));
            fusion.fuse(gpu, &frame, &pose);
            fusion.map.grow(4_000).unwrap();
        }
        (fusion.keys(), fusion.visible(gpu), fusion.read())
    };
    assert_eq!(run(), run());
}

#[test]
fn a_map_in_several_pages_is_the_same_map() {
    let Some(gpu) = common::gpu() else { return };
    // 8192 blocks a page.
    let paged = Gpu::new(&common::device_with_bindings_of(16 << 20));
    assert_eq!(paged.device.capabilities().page_shift(VoxelKind::default()), 13);

    let camera = common::camera(160, 120);
    let poses: Vec<Se3> = (0..4).map(|i| Se3::exp([0.0, 0.0, 0.0, 0.0, 1.6 * f64::from(i), 0.0])).collect();
    let run = |gpu: &Gpu| {
        let mut fusion = Fusion::new(gpu, camera, 0.005, true, 20_000);
        for pose in &poses {
            let frame = common::frame(Scene::room().depth(&camera, pose), Some(common::colours(&camera)));
            fusion.fuse(gpu, &frame, pose);
        }
        let image = fusion.cast(gpu, camera, &poses[3]);
        let keys = fusion.keys();
        let last = keys.len() as u32 - 1;
        let blocks = [0, 1, 8_191, 8_192, last].map(|i| fusion.map.read_block(i).unwrap());
        (keys, fusion.visible(gpu), image.read_points(&gpu.device).unwrap(), blocks)
    };
    let (one, several) = (run(gpu), run(&paged));
    assert!(one.0.len() > 8_192, "only {} blocks, which fit one page", one.0.len());
    assert!(one == several);
}

#[test]
fn a_view_of_one_pixel_and_one_of_a_million_fuse() {
    let Some(gpu) = common::gpu() else { return };
    for (width, height, voxel_size_m) in [(1, 1, 0.02), (1280, 1024, 0.02)] {
        let camera = common::camera(width, height);
        let mut fusion = Fusion::new(gpu, camera, voxel_size_m, false, 6_000);
        let depth = Scene::room().depth(&camera, &Se3::IDENTITY);
        let record = fusion.fuse(gpu, &common::frame(depth, None), &Se3::IDENTITY);
        assert_eq!((record.requested, record.dropped), (record.allocated, 0));
        let visible = fusion.visible(gpu);
        assert!(!visible.is_empty());
        let weights = |block: u32| fusion.map.read_block(block).unwrap().into_iter().map(|v| DistanceVoxel(v).weight());
        let heaviest = visible.iter().flat_map(|block| weights(*block)).max();
        assert_eq!(heaviest, Some(1), "{width}x{height}: voxels were fused, each once");
    }
}
