//! Stage `changed`: blocks know the last frame that changed them, through growth, removal, leaving and coming back.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use std::collections::BTreeMap;

use itm_core::Se3;
use itm_core::voxel::BlockKey;
use itm_gpu::changed::Changed;
use itm_gpu::swap::{Swap, Transfer};
use itm_gpu::{BlockMap, HostBlock, Recorder, reference};

use common::{Fusion, Gpu, RANGE_M, Scene};

fn changes(map: &BlockMap, since: u32) -> BTreeMap<[u32; 2], u32> {
    map.read_changed_since(since).unwrap().into_iter().map(|(key, frame)| (key.pack(), frame)).collect()
}

/// What the map's blocks have for a list by their packed keys: zero for those that are not in it.
fn by_index(map: &BlockMap, by_key: &BTreeMap<[u32; 2], u32>) -> Vec<u32> {
    let keys = map.read_keys().unwrap();
    keys.iter().map(|key| key.and_then(|key| by_key.get(&key.pack())).copied().unwrap_or(0)).collect()
}

/// Fuses the room from a pose as a frame; the packed keys of the blocks in its view.
fn fuse(gpu: &Gpu, fusion: &mut Fusion, stage: &Changed, pose: &Se3, frame: u32) -> Vec<[u32; 2]> {
    let depth = Scene::room().depth(&fusion.calibration.depth, pose);
    fusion.fuse(gpu, &common::frame(depth, None), pose);
    let mut expected = by_index(&fusion.map, &changes(&fusion.map, 0));
    reference::changed::mark(&mut expected, &fusion.visible(gpu), frame);
    let mut recorder = Recorder::new(&gpu.device);
    stage.record(&mut recorder, &fusion.map, frame);
    let _untimed = recorder.submit();
    assert_eq!(by_index(&fusion.map, &changes(&fusion.map, 0)), expected);
    let keys = fusion.map.read_keys().unwrap();
    fusion.visible(gpu).into_iter().map(|index| keys[index as usize].unwrap().pack()).collect()
}

#[test]
fn blocks_know_the_last_frame_that_changed_them_wherever_they_go() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(80, 60);
    let (stage, swap) = (Changed::new(&gpu.device), Swap::new(&gpu.device));
    let mut fusion = Fusion::new(gpu, camera, 0.03, false, 8_000);
    let (there, turned) = (Se3::IDENTITY, Se3::exp([0.0, 0.0, 0.0, 0.0, 0.4, 0.0]));
    let away = Se3::exp([0.0, 0.0, 0.0, 0.0, 3.1, 0.0]);
    let mut expected = BTreeMap::new();
    for (pose, frame) in [(&there, 3), (&turned, 4)] {
        expected.extend(fuse(gpu, &mut fusion, &stage, pose, frame).into_iter().map(|key| (key, frame)));
    }
    assert!(expected.values().any(|frame| *frame == 3) && expected.values().any(|frame| *frame == 4));
    assert_eq!(changes(&fusion.map, 0), expected);
    let later: BTreeMap<_, _> = expected.iter().filter(|(_, frame)| **frame > 3).map(|(k, f)| (*k, *f)).collect();
    assert_eq!(changes(&fusion.map, 3), later);
    assert!(changes(&fusion.map, 4).is_empty());

    // Growth keeps it, and so does reading everything back.
    fusion.map.grow(20_000).unwrap();
    assert_eq!(changes(&fusion.map, 0), expected);
    let state = fusion.map.read_state().unwrap();
    let copy = BlockMap::from_state(&gpu.device, *fusion.map.layout(), &state).unwrap();
    assert_eq!(changes(&copy, 0), expected);

    // All leave, and take it along.
    let transfer = Transfer::new(&gpu.device, &fusion.map, 100_000);
    let leave = |frame| {
        let mut recorder = Recorder::new(&gpu.device);
        let ages = swap.record_ages(&mut recorder, &fusion.map, &camera, &away, RANGE_M, 0.05, frame);
        let left = swap.record_leaving(&mut recorder, &fusion.map, &transfer, frame, 5, u32::MAX);
        let _untimed = recorder.submit();
        ages.read(&gpu.device).unwrap();
        left.read(&gpu.device).unwrap()
    };
    assert!(leave(1).keys.is_empty());
    let left = leave(9);
    let brought: BTreeMap<_, _> = left.keys.iter().map(|key| key.pack()).zip(left.changed.iter().copied()).collect();
    assert_eq!(brought, expected);
    assert!(changes(&fusion.map, 0).is_empty());

    // Some of their places are fused into meanwhile. Those that meet such a block are changed by the frame in which they do.
    let beside = Se3::exp([0.0, 0.0, 0.0, 0.0, 0.8, 0.0]);
    let meanwhile = fuse(gpu, &mut fusion, &stage, &beside, 5);
    assert!(meanwhile.iter().any(|key| brought.contains_key(key)));
    let length = fusion.map.layout().kind.block_words();
    let host: Vec<_> =
        left.keys.iter().zip(left.words.chunks(length)).map(|(key, words)| HostBlock { key: *key, words }).collect();
    fusion.map.lay_grid(&camera, &turned, RANGE_M[1], 2.0).unwrap();
    let before = changes(&fusion.map, 0);
    let arrivals = swap.bring(&transfer, &host);
    let mut recorder = Recorder::new(&gpu.device);
    gpu.allocate.record_with(&mut recorder, &fusion.map, None, Some(&arrivals));
    let places = swap.record_merge(&mut recorder, &fusion.map, &arrivals, 100);
    stage.record_arrivals(&mut recorder, &fusion.map, &arrivals, &left.changed, 6);
    let _untimed = recorder.submit();
    assert!(places.read(&gpu.device).unwrap().iter().all(|placed| *placed), "the grid covers all of them");
    let keys = fusion.map.read_keys().unwrap();
    let place = |key: &BlockKey| keys.iter().position(|k| *k == Some(*key)).map(|index| index as u32);
    let places: Vec<_> = left.keys.iter().map(place).collect();
    let mut after = by_index(&fusion.map, &before);
    reference::changed::arrive(&mut after, &places, &left.changed, 6);
    assert_eq!(by_index(&fusion.map, &changes(&fusion.map, 0)), after);
    for frame in [3, 4, 5, 6] {
        assert!(after.contains(&frame), "no block of frame {frame}");
    }
}
