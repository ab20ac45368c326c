//! Several submaps as one map, against the scene that they were made of.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use std::collections::BTreeMap;

use glam::{DQuat, DVec3, IVec3, Vec3};
use itm_gpu::reference::Block;
use itm_slam::sample::distance_in_block;
use itm_slam::voxel::{BlockKey, ColourVoxel, DistanceKind, DistanceVoxel, VoxelKind};
use itm_slam::{
    BlockSource, Combined, Device, Error, Intrinsics, MapLayout, MapViews, MeshOptions, Se3, mesh_in_chunks,
};

const VOXEL_M: f64 = 1.0 / 128.0;
const BAND_M: f64 = 4.0 * VOXEL_M;
const KIND: VoxelKind = VoxelKind { distance: DistanceKind::I16, colour: true, confidence: true };
const MAX_WEIGHT: u16 = 100;

/// The device; `None` where the environment variable `ITM_SKIP_GPU_TESTS` is set.
#[expect(clippy::print_stdout, reason = "a test that checks nothing says so")]
fn device() -> Option<Device> {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        println!("skipped, because ITM_SKIP_GPU_TESTS is set");
        return None;
    }
    Some(Device::open("auto").expect("GPU tests need an adapter; a software driver will do"))
}

/// Blocks in memory, which counts what is read of them.
#[derive(Clone, Debug, Default)]
struct Memory {
    blocks: BTreeMap<[u32; 2], Vec<u32>>,
    read: usize,
    most_at_once: usize,
}

impl BlockSource for Memory {
    fn layout(&self) -> MapLayout {
        MapLayout { voxel_size_m: VOXEL_M as f32, truncation_m: BAND_M as f32, kind: KIND }
    }

    fn keys(&self) -> Vec<BlockKey> {
        self.blocks.keys().copied().map(BlockKey::unpack).collect()
    }

    fn read(&mut self, keys: &[BlockKey], words: &mut [u32]) -> Result<(), Error> {
        self.read += keys.len();
        self.most_at_once = self.most_at_once.max(keys.len());
        for (key, words) in keys.iter().zip(words.chunks_exact_mut(KIND.block_words())) {
            words.copy_from_slice(&self.blocks[&key.pack()]);
        }
        Ok(())
    }
}

/// A ball in the world's frame (metres) with a wall beneath, whose upper side is at y = 0.25: signed distance.
fn scene(p: DVec3) -> f64 {
    (p.distance(BALL) - RADIUS).min(0.25 - p.y)
}

const BALL: DVec3 = DVec3::new(0.031, -0.042, 0.5);
const RADIUS: f64 = 0.22;

fn colour(p: DVec3) -> [u8; 3] {
    let shade = |c: f64| (128.0 + 400.0 * c).clamp(0.0, 255.0) as u8;
    [shade(p.x), shade(p.y), shade(p.z - 0.5)]
}

/// What a camera would have made of the part of the scene where `part` holds, in the submap's own frame.
fn submap(submap: u16, world_from_submap: &Se3, weight: u16, part: impl Fn(DVec3) -> bool) -> Memory {
    let mut memory = Memory::default();
    let corner = |i: usize| DVec3::new([-0.45, 0.45][i & 1], [-0.35, 0.35][i >> 1 & 1], [0.1, 0.9][i >> 2]);
    let corners = (0..8).map(|i| world_from_submap.inverse().transform_point(corner(i)) / (8.0 * VOXEL_M));
    let (low, high) = corners.map(|c| (c, c)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap();
    let (low, high) = (low.floor().as_ivec3(), high.floor().as_ivec3());
    for position in (low.z..=high.z)
        .flat_map(|z| (low.y..=high.y).flat_map(move |y| (low.x..=high.x).map(move |x| IVec3::new(x, y, z))))
    {
        let middle = world_from_submap.transform_point(((position * 8).as_dvec3() + 3.5) * VOXEL_M);
        // As fusion allocates: around the surface, and not far behind it.
        if scene(middle).abs() > BAND_M + 6.1 * VOXEL_M {
            continue;
        }
        let mut block = Block::default();
        let mut near = false;
        for i in 0..512_usize {
            let voxel = position * 8 + IVec3::new(i as i32 & 7, i as i32 >> 3 & 7, i as i32 >> 6);
            let p = world_from_submap.transform_point(voxel.as_dvec3() * VOXEL_M);
            let distance = scene(p);
            if distance < -BAND_M || !part(p) || p.abs().max_element() > 0.9 {
                continue;
            }
            near |= distance.abs() < BAND_M;
            block.distances[i] = DistanceVoxel::new((distance / BAND_M) as f32, weight);
            if distance.abs() < BAND_M {
                block.colours[i] = ColourVoxel::new(colour(p), weight.min(255) as u8);
            }
            block.confidences[i] = 1.5;
        }
        if near {
            memory.blocks.insert(BlockKey { submap, position }.pack(), block.to_words(KIND));
        }
    }
    memory
}

fn together(parts: impl IntoIterator<Item = Memory>) -> Memory {
    let blocks = parts.into_iter().flat_map(|part| part.blocks).collect();
    Memory { blocks, ..Memory::default() }
}

/// Two submaps that share the middle: the world's own, and one that is turned by 20 degrees and lies between its voxels.
fn two() -> (Memory, [(u16, Se3); 2]) {
    let axis = DVec3::new(0.3, 1.0, -0.2).normalize();
    let turned = Se3::new(DQuat::from_axis_angle(axis, 20_f64.to_radians()), DVec3::new(10.5, -3.5, 7.5) * VOXEL_M);
    let poses = [(0, Se3::IDENTITY), (4, turned)];
    let map =
        together([submap(0, &poses[0].1, 6, |p| p.x < 0.12), submap(4, &poses[1].1, 3, |p| p.x > -0.1 && p.z < 0.85)]);
    (map, poses)
}

fn read_all(source: &mut dyn BlockSource) -> (Vec<BlockKey>, Vec<u32>) {
    let keys = source.keys();
    let mut words = vec![0; keys.len() * KIND.block_words()];
    source.read(&keys, &mut words).unwrap();
    (keys, words)
}

/// How far a distance, in bands, is off, in voxels; asked only where interpolation meets no truncated voxel.
fn off_in_band(p: DVec3, distance: f32) -> Option<f64> {
    let truth = scene(p) / BAND_M;
    (truth.abs() < 0.5).then(|| (f64::from(distance) - truth).abs() * BAND_M / VOXEL_M)
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

#[test]
fn voxels_are_those_of_the_scene_and_weights_add_up() {
    let (mut map, poses) = two();
    let before = map.blocks.len();
    let mut combined = Combined::new(&mut map, &poses, 8).unwrap();
    let (keys, words) = read_all(&mut combined);
    assert!(keys.is_sorted_by_key(|key| key.position.to_array()) && keys.iter().all(|key| key.submap == 0));
    assert_eq!(combined.keys(), keys);
    let (mut off, mut of_both, mut unseen) = (Vec::new(), 0, 0);
    for (key, block) in keys.iter().zip(words.chunks(KIND.block_words())) {
        unseen += usize::from(block.iter().all(|word| *word == 0));
        for i in 0..512 {
            let voxel = key.position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6);
            let (distance, weight) = distance_in_block(KIND, block, voxel);
            if weight == 0 {
                continue;
            }
            let p = voxel.as_dvec3() * VOXEL_M;
            off.extend(off_in_band(p, distance));
            let confidence = f32::from_bits(block[KIND.confidences_at() + i as usize]);
            // 6 and 3 are 9, and more than there may be.
            assert!([3, 6, 8].contains(&weight) && confidence == if weight == 8 { 3.0 } else { 1.5 });
            of_both += usize::from(weight == 8);
        }
    }
    assert!(of_both > off.len() / 20, "{of_both} of {} voxels were seen by both", off.len());
    assert!(unseen * 5 < keys.len(), "{unseen} of {} blocks were not seen, of {before}", keys.len());
    let (most, all) = (quantile(&mut off, 0.99), quantile(&mut off, 1.0));
    assert!(most < 0.1 && all < 0.5, "99 % of voxels are {most} voxels off, all {all}");
}

#[test]
fn what_one_submap_in_the_worlds_frame_has_seen_is_its_own_to_the_bit() {
    let mut alone = together([submap(0, &Se3::IDENTITY, 500, |p| p.x < 0.12)]);
    // A voxel that was forgotten keeps its distance.
    alone.blocks.values_mut().next().unwrap()[17] = DistanceVoxel::new(0.25, 0).0;
    let (keys, words) = read_all(&mut alone);
    let mut combined = Combined::new(&mut alone, &[(0, Se3::IDENTITY)], MAX_WEIGHT).unwrap();
    let (combined_keys, combined_words) = read_all(&mut combined);
    let of = |keys: &[BlockKey], words: &[u32]| -> BTreeMap<[u32; 2], Vec<u32>> {
        keys.iter().map(|key| key.pack()).zip(words.chunks(KIND.block_words()).map(Vec::from)).collect()
    };
    assert!(of(&keys, &words) == of(&combined_keys, &combined_words));

    // By whole voxels, and beside another one: where that one has nothing to say.
    let moved = Se3::new(DQuat::IDENTITY, DVec3::new(3.0, -11.0, 40.0) * VOXEL_M);
    let far = Se3::new(DQuat::from_rotation_z(0.4), DVec3::new(0.2, 0.1, 0.0));
    let first = submap(2, &moved, 6, |p| p.x < 0.12);
    let mut map = together([first.clone(), submap(5, &far, 6, |p| p.x > 0.0)]);
    let (keys, words) = read_all(&mut Combined::new(&mut map, &[(2, moved), (5, far)], MAX_WEIGHT).unwrap());
    let made = of(&keys, &words);
    let (mut same, mut shared) = (0, 0);
    for (key, block) in &first.blocks {
        for i in (0..512_usize).filter(|i| block[*i] >> 16 != 0) {
            let voxel =
                BlockKey::unpack(*key).position * 8 + IVec3::new(i as i32 & 7, i as i32 >> 3 & 7, i as i32 >> 6);
            let voxel = voxel + IVec3::new(3, -11, 40);
            let there = &made[&BlockKey { submap: 0, position: voxel.div_euclid(IVec3::splat(8)) }.pack()];
            let at = voxel.rem_euclid(IVec3::splat(8)).dot(IVec3::new(1, 8, 64)) as usize;
            if there[at] >> 16 == 6 {
                assert!((0..3).all(|plane| there[plane * 512 + at] == block[plane * 512 + i]));
                same += 1;
            } else {
                shared += 1;
            }
        }
    }
    assert!(same > 10_000 && shared > 10_000, "{same} and {shared} voxels");
}

#[test]
fn the_order_of_submaps_and_of_reading_changes_nothing() {
    let (mut map, poses) = two();
    let (keys, words) = read_all(&mut Combined::new(&mut map, &poses, MAX_WEIGHT).unwrap());
    let (again_keys, again) = read_all(&mut Combined::new(&mut map, &[poses[1], poses[0]], MAX_WEIGHT).unwrap());
    assert!(keys == again_keys && words == again);
    // Numbered the other way round, the sums are made in another order.
    let swapped = |key: &[u32; 2]| {
        let key = BlockKey::unpack(*key);
        BlockKey { submap: 4 - key.submap, ..key }.pack()
    };
    let mut renamed = map.clone();
    renamed.blocks = map.blocks.iter().map(|(key, words)| (swapped(key), words.clone())).collect();
    let poses = poses.map(|(submap, pose)| (4 - submap, pose));
    let mut combined = Combined::new(&mut renamed, &poses, MAX_WEIGHT).unwrap();
    let (other_keys, other) = read_all(&mut combined);
    assert_eq!(keys, other_keys);
    let steps = |a: u32, b: u32| (a & 0xffff).abs_diff(b & 0xffff);
    let blocks = words.chunks(KIND.block_words()).zip(other.chunks(KIND.block_words()));
    assert!(blocks.clone().all(|(a, b)| (0..512).all(|i| steps(a[i], b[i]) <= 1 && a[i] >> 16 == b[i] >> 16)));
    // One by one, from the last to the first.
    for (key, expected) in keys.iter().zip(blocks.map(|(_, b)| b)).rev().step_by(7) {
        let mut block = vec![1; KIND.block_words()];
        combined.read(&[*key], &mut block).unwrap();
        assert!(block == expected);
    }
}

#[test]
fn forty_submaps_are_one_map() {
    let pose = |i: u16| {
        let i = f64::from(i);
        Se3::exp([0.03 * i, 0.011 * i, -0.02 * i, 0.02 * i, -0.15 * i, 0.013 * i])
    };
    let poses: Vec<(u16, Se3)> = (0..40).map(|i| (1000 + i, pose(i))).collect();
    let mut map =
        together(poses.iter().map(|(number, pose)| submap(*number, pose, 50, |p| p.distance(BALL) < RADIUS + 0.05)));
    let all = map.blocks.len();
    let mut combined = Combined::new(&mut map, &poses, 1600).unwrap();
    let (keys, words) = read_all(&mut combined);
    let (mut off, mut full) = (Vec::new(), 0);
    for (key, block) in keys.iter().zip(words.chunks(KIND.block_words())) {
        for i in (0..512).filter(|i| block[*i as usize] >> 16 != 0) {
            let voxel = key.position * 8 + IVec3::new(i & 7, i >> 3 & 7, i >> 6);
            let (distance, weight) = distance_in_block(KIND, block, voxel);
            off.extend(off_in_band(voxel.as_dvec3() * VOXEL_M, distance));
            full += usize::from(weight == 1600);
        }
    }
    let most = quantile(&mut off, 0.99);
    assert!(most < 0.1 && full > off.len() / 2, "{most} voxels off, {full} of {} full", off.len());
    // As much as is kept is read at once, and what is kept is not read again and again.
    assert!(
        map.most_at_once <= 4096 && map.read < 4 * all,
        "{} of {all} at once, {} in all",
        map.most_at_once,
        map.read
    );
}

#[test]
fn submaps_without_a_place_are_refused() {
    let (mut map, poses) = two();
    let mut refused = |poses: &[(u16, Se3)]| Combined::new(&mut map, poses, MAX_WEIGHT).map(|_| ()).unwrap_err();
    assert!(matches!(refused(&poses[..1]), Error::NoSubmapPose { submap: 4 }));
    assert!(matches!(refused(&[]), Error::NoSubmapPose { submap: 0 }));
    let twice = [poses[0], poses[1], poses[1]];
    assert!(matches!(refused(&twice), Error::TwoSubmapPoses { submap: 4 }));
    let lost = |translation| Se3 { translation, ..Se3::IDENTITY };
    let nowhere = [poses[0], (4, lost(DVec3::new(0.0, f64::NAN, 0.0)))];
    let error = refused(&nowhere);
    assert!(matches!(error, Error::SubmapPose { submap: 4, .. }) && error.to_string().contains("finite"), "{error}");
    let far = refused(&[poses[0], (4, lost(DVec3::splat(1e9)))]);
    assert!(matches!(far, Error::SubmapOutOfReach { submap: 4 }), "{far}");
    // One that has no blocks takes no part.
    let more = [poses[0], poses[1], (9, lost(DVec3::splat(1e9)))];
    assert!(Combined::new(&mut map, &more, MAX_WEIGHT).is_ok());
}

#[test]
fn a_ball_in_two_submaps_is_closed_and_where_it_is() {
    let Some(device) = device() else { return };
    let (mut map, poses) = two();
    let mut combined = Combined::new(&mut map, &poses, MAX_WEIGHT).unwrap();
    let options = MeshOptions { max_blocks: 400, ..MeshOptions::default() };
    let mut mesh = mesh_in_chunks(&device, &mut combined, &options, &mut |_, _| ()).unwrap();
    let mut off: Vec<f64> = mesh.positions.iter().map(|p| scene(p.as_dvec3()).abs() / VOXEL_M).collect();
    let (half, most) = (quantile(&mut off, 0.5), quantile(&mut off, 0.99));
    assert!(off.len() > 10_000 && half < 0.02 && most < 0.1, "half {half}, 99 % {most} voxels of {}", off.len());
    let mut turned: Vec<f64> = (mesh.positions.iter().zip(&mesh.colours))
        .map(|(p, found)| {
            let truth = colour(p.as_dvec3());
            (0..3).map(|c| f64::from(truth[c].abs_diff(found[c]))).fold(0.0, f64::max)
        })
        .collect();
    let most_colours = quantile(&mut turned, 0.99);
    assert!(most_colours < 8.0, "colours differ by {most_colours}");
    let reach = Vec3::splat((RADIUS + 2.0 * VOXEL_M) as f32);
    mesh = mesh.crop(BALL.as_vec3() - reach, BALL.as_vec3() + reach);
    assert!(mesh.is_watertight() && mesh.triangles.len() > 10_000, "{} triangles", mesh.triangles.len());
    // Nowhere two surfaces.
    assert_eq!(2 * mesh.positions.len(), mesh.triangles.len() + 4);
}

#[test]
fn views_show_both_submaps() {
    let Some(device) = device() else { return };
    let (mut map, poses) = two();
    let mut combined = Combined::new(&mut map, &poses, MAX_WEIGHT).unwrap();
    let camera = Intrinsics::new(160, 120, 150.0, 150.0, 79.5, 59.5);
    let mut views = MapViews::new(&device, combined.layout(), 0, 10_000).unwrap();
    views.look(&mut combined, &camera, &Se3::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, -0.1)), 1.5).unwrap();
    let seen = views.points().unwrap();
    let mut off: Vec<f64> = seen.positions.iter().map(|p| scene(p.as_dvec3()).abs() / VOXEL_M).collect();
    // Rays that graze the ball end short of it.
    let most = quantile(&mut off, 0.9);
    assert!(off.len() > 4000 && most < 0.2, "{most} voxels at {} points", off.len());
    let weights: Vec<f32> = [3.0, 6.0, 9.0].into_iter().filter(|w| seen.weights.contains(w)).collect();
    assert_eq!(weights, [3.0, 6.0, 9.0]);
}
