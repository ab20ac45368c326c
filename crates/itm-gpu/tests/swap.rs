//! Stage `swap`: blocks that leave and come back are the same, and what met at one place is fused as the reference does.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use std::collections::BTreeMap;

use glam::IVec3;
use itm_core::block::merge_blocks;
use itm_core::voxel::{BLOCK_VOXELS, BlockKey, ColourVoxel, DistanceKind, DistanceVoxel, FloatVoxel, VoxelKind};
use itm_core::{Image, Intrinsics, Se3};
use itm_gpu::swap::{Left, Swap, Transfer, age_of_bin};
use itm_gpu::{BlockMap, HostBlock, MapLayout, Recorder};
use proptest::prelude::*;
use rand::SeedableRng as _;

use common::{Fusion, Gpu, RANGE_M, Scene};

const KINDS: [VoxelKind; 4] = [
    VoxelKind { distance: DistanceKind::I16, colour: false, confidence: false },
    VoxelKind { distance: DistanceKind::I16, colour: true, confidence: true },
    VoxelKind { distance: DistanceKind::F32, colour: true, confidence: false },
    VoxelKind { distance: DistanceKind::F32, colour: false, confidence: true },
];

/// A map's blocks by their keys.
fn blocks(map: &BlockMap) -> BTreeMap<[u32; 2], Vec<u32>> {
    let keys = map.read_keys().unwrap().into_iter().zip(0..);
    keys.filter_map(|(key, index)| Some((key?.pack(), map.read_block(index).unwrap()))).collect()
}

/// Notes that a view reaches blocks, has those leave that none has reached for a while, and waits for them.
fn leave(
    gpu: &Gpu,
    fusion: &Fusion,
    swap: &Swap,
    transfer: &Transfer,
    camera: &Intrinsics,
    pose: &Se3,
    (frame, least_age): (u32, u32),
) -> (Vec<u32>, Left) {
    let mut recorder = Recorder::new(&gpu.device);
    let ages = swap.record_ages(&mut recorder, &fusion.map, camera, pose, RANGE_M, 0.05, frame);
    let left = swap.record_leaving(&mut recorder, &fusion.map, transfer, frame, least_age, u32::MAX);
    let _untimed = recorder.submit();
    (ages.read(&gpu.device).unwrap(), left.read(&gpu.device).unwrap())
}

/// Brings blocks back into a grid that covers them; whether each found room.
fn bring(gpu: &Gpu, fusion: &Fusion, swap: &Swap, transfer: &Transfer, left: &Left, max_weight: u16) -> Vec<bool> {
    let length = fusion.map.layout().kind.block_words();
    let host: Vec<_> =
        (left.keys.iter().zip(left.words.chunks(length))).map(|(key, words)| HostBlock { key: *key, words }).collect();
    let arrivals = swap.bring(transfer, &host);
    let mut recorder = Recorder::new(&gpu.device);
    gpu.allocate.record_with(&mut recorder, &fusion.map, None, Some(&arrivals));
    let places = swap.record_merge(&mut recorder, &fusion.map, &arrivals, max_weight);
    let _untimed = recorder.submit();
    places.read(&gpu.device).unwrap()
}

#[test]
fn blocks_leave_by_age_and_come_back_as_they_were() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(80, 60);
    let (swap, away) = (Swap::new(&gpu.device), Se3::exp([0.0, 0.0, 0.0, 0.0, 3.1, 0.0]));
    for kind in KINDS {
        let mut fusion = Fusion::of_kind(gpu, common::one_camera(camera), 0.02, kind, 4_000);
        let depth = Scene::room().depth(&camera, &Se3::IDENTITY);
        let frame = common::frame(depth, Some(common::colours(&camera)));
        fusion.fuse(gpu, &frame, &Se3::IDENTITY);
        let before = blocks(&fusion.map);
        let transfer = Transfer::new(&gpu.device, &fusion.map, 100_000);
        let (ages, left) = leave(gpu, &fusion, &swap, &transfer, &camera, &Se3::IDENTITY, (1, 1));
        assert!(ages.iter().all(|count| *count == 0) && left.keys.is_empty(), "all blocks are in view");
        // The view goes elsewhere: blocks age, and leave once they are old enough.
        let (ages, left) = leave(gpu, &fusion, &swap, &transfer, &camera, &away, (3, 5));
        assert_eq!((ages[2] as usize, left.keys.len()), (before.len(), 0));
        let (ages, left) = leave(gpu, &fusion, &swap, &transfer, &camera, &away, (6, 5));
        let bin = (0..64).find(|bin| age_of_bin(*bin) == 5).unwrap();
        assert_eq!((ages[bin] as usize, left.keys.len()), (before.len(), before.len()));
        assert!(blocks(&fusion.map).is_empty());
        let record = fusion.map.read_record().unwrap();
        assert_eq!(record.blocks, record.free_blocks);
        let found: BTreeMap<_, _> = left
            .keys
            .iter()
            .map(|k| k.pack())
            .zip(left.words.chunks(kind.block_words()).map(<[u32]>::to_vec))
            .collect();
        assert!(found == before);

        // Half of them at a time, as they fit the buffer.
        fusion.map.lay_grid(&camera, &Se3::IDENTITY, RANGE_M[1], 0.1).unwrap();
        let half = left.keys.len() / 2;
        let part =
            |keys: &[BlockKey], words: &[u32]| Left { keys: keys.to_vec(), words: words.to_vec(), changed: Vec::new() };
        let (words_a, words_b) = left.words.split_at(half * kind.block_words());
        for some in [part(&left.keys[..half], words_a), part(&left.keys[half..], words_b)] {
            assert!(bring(gpu, &fusion, &swap, &transfer, &some, 100).iter().all(|placed| *placed));
        }
        assert!(blocks(&fusion.map) == before);
        let keys: Vec<_> = before.keys().map(|k| BlockKey::unpack(*k)).collect();
        assert!(gpu.hash.look_up(&fusion.map, &keys).unwrap().iter().all(Option::is_some));
    }
}

#[test]
fn what_finds_no_room_is_said_and_nothing_else_is_touched() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(16, 12);
    let kind = KINDS[1];
    let fusion = {
        let mut fusion = Fusion::of_kind(gpu, common::one_camera(camera), 0.02, kind, 8);
        fusion.map.lay_grid(&camera, &Se3::IDENTITY, RANGE_M[1], 0.1).unwrap();
        fusion
    };
    let (swap, transfer) = (Swap::new(&gpu.device), Transfer::new(&gpu.device, &fusion.map, 100));
    let keys: Vec<_> = (0..12).map(|i| BlockKey { submap: 0, position: IVec3::new(i % 4 - 2, i / 4 - 1, 6) }).collect();
    let mut rng = rand_pcg::Pcg32::seed_from_u64(3);
    let words: Vec<u32> = keys.iter().flat_map(|_| random_block(kind, &mut rng)).collect();
    let outside = BlockKey { submap: 0, position: IVec3::new(0, 0, 10_000) };
    let left = Left {
        keys: [&keys[..], &[outside]].concat(),
        words: [&words[..], &vec![9; kind.block_words()]].concat(),
        changed: Vec::new(),
    };
    let placed = bring(gpu, &fusion, &swap, &transfer, &left, 100);
    assert_eq!(placed.iter().filter(|placed| **placed).count(), 8);
    assert!(!placed[12], "no grid cell, no place");
    let found = blocks(&fusion.map);
    // Voxels that were never seen come back as such.
    let seen = |words: &[u32]| {
        let mut block = vec![0; words.len()];
        merge_blocks(kind, &mut block, words, 100);
        block
    };
    for ((key, placed), words) in keys.iter().zip(&placed).zip(words.chunks(kind.block_words())) {
        assert_eq!(found.get(&key.pack()), placed.then(|| seen(words)).as_ref());
    }
}

/// Voxels as integration leaves them, some of them never seen.
fn random_block(kind: VoxelKind, rng: &mut impl rand::Rng) -> Vec<u32> {
    let mut distances = Vec::new();
    let (mut colours, mut confidences) = (Vec::new(), Vec::new());
    for _ in 0..BLOCK_VOXELS {
        let weight = if rng.random_bool(0.3) { 0 } else { rng.random_range(1..200_u16) };
        let distance = if weight == 0 { 1.0 } else { rng.random_range(-1.0..1.0_f32) };
        match kind.distance {
            DistanceKind::I16 => distances.push(DistanceVoxel::new(distance, weight).0),
            DistanceKind::F32 => {
                distances.extend_from_slice(bytemuck::cast_slice(&[FloatVoxel::new(distance, weight)]));
            }
        }
        let weight = if rng.random_bool(0.3) { 0 } else { rng.random_range(1..=255_u8) };
        colours.push(ColourVoxel::new(rng.random(), weight).0);
        confidences.push(if weight == 0 { 0 } else { rng.random_range(0.1..150.0_f32).to_bits() });
    }
    if kind.colour {
        distances.extend(colours);
    }
    if kind.confidence {
        distances.extend(confidences);
    }
    distances
}

/// As whole numbers in which the device may be one step off the reference.
fn steps(kind: VoxelKind, words: &[u32]) -> Vec<f64> {
    let (distances, rest) = words.split_at(kind.distance_words() * BLOCK_VOXELS);
    let mut steps: Vec<f64> = match kind.distance {
        DistanceKind::I16 => {
            distances.iter().flat_map(|w| [f64::from(w & 0xffff), 10.0 * f64::from(w >> 16)]).collect()
        }
        DistanceKind::F32 => bytemuck::cast_slice::<u32, FloatVoxel>(distances)
            .iter()
            .flat_map(|v| [f64::from(v.distance()) * 32767.5, 10.0 * f64::from(v.weight())])
            .collect(),
    };
    let (colours, confidences) = rest.split_at(if kind.colour { BLOCK_VOXELS } else { 0 });
    // Colours are merged in whole numbers, without a step's slack.
    steps.extend(colours.iter().flat_map(|w| w.to_le_bytes()).map(|byte| 10.0 * f64::from(byte)));
    steps.extend(confidences.iter().map(|w| 1e4 * f64::from(f32::from_bits(*w))));
    steps
}

proptest! {
    #![proptest_config(common::cases(12))]

    #[test]
    fn blocks_that_meet_are_merged_as_the_reference_does(seed: u64, which in 0..4_usize, max_weight in 1..400_u16) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let kind = KINDS[which];
        let mut rng = rand_pcg::Pcg32::seed_from_u64(seed);
        let camera = common::camera(16, 12);
        let mut fusion = Fusion::of_kind(gpu, common::one_camera(camera), 0.02, kind, 64);
        fusion.map.lay_grid(&camera, &Se3::IDENTITY, RANGE_M[1], 0.1).unwrap();
        let (swap, transfer) = (Swap::new(&gpu.device), Transfer::new(&gpu.device, &fusion.map, 100));
        let keys: Vec<_> =
            (0..9).map(|i| BlockKey { submap: 0, position: IVec3::new(i % 3 - 1, i / 3 - 1, 6) }).collect();
        let here: Vec<_> = keys.iter().map(|_| random_block(kind, &mut rng)).collect();
        // The first six are there already, the last six arrive.
        let held: Vec<_> = keys.iter().zip(&here).take(6).map(|(key, words)| HostBlock { key: *key, words }).collect();
        fusion.map.insert_blocks(&held).unwrap();
        let coming: Vec<_> = (0..6).map(|_| random_block(kind, &mut rng)).collect();
        let left = Left { keys: keys[3..].to_vec(), words: coming.concat(), changed: Vec::new() };
        prop_assert!(bring(gpu, &fusion, &swap, &transfer, &left, max_weight).iter().all(|placed| *placed));
        let found = blocks(&fusion.map);
        for (i, key) in keys.iter().enumerate() {
            let mut expected = if i < 6 { here[i].clone() } else { vec![0; kind.block_words()] };
            if i >= 3 {
                merge_blocks(kind, &mut expected, &coming[i - 3], max_weight);
            }
            let (found, expected) = (steps(kind, &found[&key.pack()]), steps(kind, &expected));
            for (a, b) in found.iter().zip(&expected) {
                prop_assert!((a - b).abs() <= 1.01, "{a} but {b}");
            }
        }
    }
}

/// The mean and the largest number of slots that looking one of the map's blocks up reads.
fn probes(map: &BlockMap) -> (f64, u32) {
    let numbers = map.read_probes().unwrap();
    let sum: u64 = numbers.iter().map(|n| u64::from(*n)).sum();
    (sum as f64 / numbers.len() as f64, numbers.iter().copied().max().unwrap_or(0))
}

/// Ten thousand frames along a corridor without an end: blocks come at its front and leave behind. Nothing piles up.
#[test]
fn an_hour_along_a_corridor_leaves_look_ups_as_short_as_they_were() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(160, 120);
    let layout = MapLayout { voxel_size_m: 0.05, truncation_m: 0.2, kind: VoxelKind::default() };
    let mut fusion = Fusion::new(gpu, camera, 0.05, false, 4_096);
    fusion.map = BlockMap::new(&gpu.device, layout, 4_096).unwrap();
    let (swap, transfer) = (Swap::new(&gpu.device), Transfer::new(&gpu.device, &fusion.map, 512));
    // A tunnel along z, 2.4 m wide: what the camera sees is the same everywhere.
    let depth = Image::from_fn(camera.width, camera.height, |x, y| {
        let ray = camera.unproject(glam::DVec2::new(x.into(), y.into()), 1.0);
        let z = 1.2 / ray.x.abs().max(ray.y.abs()).max(1e-6);
        if z < 4.0 { z as f32 } else { 0.0 }
    });
    let frame = common::frame(depth, None);
    let mut of_decades = Vec::new();
    for i in 1..=10_000_u32 {
        // Off the lattice, so that frames differ; blocks come at 0.3 m a frame.
        let pose = Se3::exp([0.0, 0.0, 0.03 * f64::from(i), 0.0, 0.0, 0.0]);
        if i % 10 == 1 {
            let record = fusion.allocate(gpu, &frame, &pose);
            assert_eq!(record.pending, 0, "frame {i}: blocks wait");
            let mut recorder = Recorder::new(&gpu.device);
            let _ages = swap.record_ages(&mut recorder, &fusion.map, &camera, &pose, RANGE_M, 0.05, i);
            swap.record_deletion(&mut recorder, &fusion.map, &transfer, i, 10, u32::MAX);
            if record.tombstones > fusion.map.hash_slots() / 4 {
                gpu.hash.rebuild(&mut recorder, &fusion.map);
            }
            let _untimed = recorder.submit();
        }
        if i % 1_000 == 0 {
            of_decades.push(probes(&fusion.map));
        }
    }
    let (first, last) = (of_decades[0], of_decades[9]);
    assert!(first.0 > 0.9, "{of_decades:?}");
    assert!(last.0 < 1.2 * first.0 && last.0 < 2.0, "look-ups become longer: {of_decades:?}");
    assert!(of_decades.iter().all(|(_, longest)| *longest < 40), "{of_decades:?}");
}
