//! Maps that are saved and loaded, and maps that do not all lie on the device: of one part, and of submaps.
//!
//! Tracked sessions of submaps come to several of them within the few frames here. Given poses are those of one map: with
//! `mode = "loop-closure"` they make no submaps, by design, which each test that has them checks.

use std::collections::{BTreeSet, HashMap};

use glam::{IVec3, Vec3};
use itm_slam::{
    Calibration, DepthConversion, DepthImage, Device, Frame, FrameStatus, Image, Intrinsics, MapIndex, Mode, Notice,
    Poses, SavedSession, Se3, Settings, Shading, Slam, Swapping, Timestamp, Trajectory, Warning,
};
use itm_synth::{Path, Sequence};
use itm_tests::{device, sequence};

const MODES: [Mode; 2] = [Mode::Basic, Mode::LoopClosure];

/// Small voxels' worth of map for small images, and submaps that begin after some frames.
fn settings(mode: Mode, device_budget_mib: f64) -> Settings {
    let mut settings = Settings { mode, ..Settings::default() };
    (settings.submaps.new_below, settings.submaps.max_active) = (0.5, 2);
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    settings.map.device_budget_mib = device_budget_mib;
    settings
}

/// Checks that a session has come to several submaps where the mode makes any and poses are tracked.
fn check_submaps(slam: &Slam, poses: Poses) {
    let submaps = slam.submaps().len();
    let several = slam.settings().mode == Mode::LoopClosure && poses == Poses::Tracked;
    assert!(if several { submaps >= 2 } else { submaps == 0 }, "{submaps} submaps");
}

/// Processes frames; whether any found no room.
fn process(slam: &mut Slam, sequence: &Sequence, frames: std::ops::Range<usize>) -> bool {
    let mut full = false;
    for frame in sequence.frames().skip(frames.start).take(frames.len()) {
        let result = slam.process(&frame).expect("a result");
        let notices = result.report.into_iter().flat_map(|report| report.notices);
        full |= notices.into_iter().any(|notice| matches!(notice, Notice::Waiting { .. } | Notice::Dropped { .. }));
    }
    full
}

fn start(device: &Device, sequence: &Sequence, settings: &Settings, poses: Poses) -> Slam {
    Slam::new(device, &sequence.calibration(), settings, poses).expect("a small map fits")
}

/// The largest distance between positions of two trajectories with the same frames.
fn apart(a: &Trajectory, b: &Trajectory) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.poses().iter().zip(b.poses());
    pairs.map(|(a, b)| a.world_from_camera.translation.distance(b.world_from_camera.translation)).fold(0.0, f64::max)
}

#[test]
fn a_session_that_is_saved_goes_on_as_if_it_had_never_stopped() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let sequence = sequence(Path::Loop, (160, 120), 60);
    // With all blocks on the device, and with most of them on the way between device and host.
    for (mode, budget, poses) in [
        (Mode::Basic, 0.0, Poses::Tracked),
        (Mode::Basic, 2.0, Poses::Given),
        (Mode::LoopClosure, 0.0, Poses::Tracked),
        (Mode::LoopClosure, 6.0, Poses::Tracked),
        (Mode::LoopClosure, 2.0, Poses::Given),
    ] {
        let settings = settings(mode, budget);
        let mut whole = start(&device, &sequence, &settings, poses);
        process(&mut whole, &sequence, 0..60);
        check_submaps(&whole, poses);
        let at = |name: &str| folder.path().join(name);
        whole.save(&at("whole.itm")).expect("saved");

        let mut first = start(&device, &sequence, &settings, poses);
        process(&mut first, &sequence, 0..37);
        first.save(&at("half.itm")).expect("saved");
        assert_eq!(first.stored_blocks() > 0, budget > 0.0, "{} blocks are stored", first.stored_blocks());
        let saved = SavedSession::open(&at("half.itm")).expect("a session");
        assert_eq!((saved.next_frame, saved.poses), (37, poses));
        let mut second = Slam::resume(&device, &at("half.itm")).expect("resumed");
        process(&mut second, &sequence, 37..60);
        second.save(&at("second.itm")).expect("saved");
        assert!(second.trajectory() == whole.trajectory(), "another trajectory with {budget} MiB, {mode:?}");
        let bytes = |name: &str| std::fs::read(at(name)).expect("it was written");
        assert!(bytes("second.itm") == bytes("whole.itm"), "another map with {budget} MiB, {mode:?}");

        // Saving has not changed what the session does.
        process(&mut first, &sequence, 37..60);
        first.save(&at("first.itm")).expect("saved");
        assert!(bytes("first.itm") == bytes("whole.itm"));
    }
}

#[test]
fn a_map_beyond_the_devices_budget_is_the_same_map() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Loop, (160, 120), 80);
    // Several submaps have several views to keep.
    for (mode, poses, budget) in [
        (Mode::Basic, Poses::Tracked, 3.0),
        (Mode::LoopClosure, Poses::Given, 3.0),
        (Mode::LoopClosure, Poses::Tracked, 6.0),
    ] {
        let mut unbounded = start(&device, &sequence, &settings(mode, 0.0), poses);
        assert!(!process(&mut unbounded, &sequence, 0..80));
        check_submaps(&unbounded, poses);
        let bytes = unbounded.map_bytes();
        let mut bounded = start(&device, &sequence, &settings(mode, budget), poses);
        assert!(!process(&mut bounded, &sequence, 0..80));
        assert!(bounded.stored_blocks() > 0, "all blocks fit the budget");
        assert!(bounded.map_bytes() < bytes, "{} and {bytes} bytes", bounded.map_bytes());
        let apart = apart(unbounded.trajectory(), bounded.trajectory());
        assert!(apart < 1e-3, "{apart} m apart");
        // The whole map is meshed and seen, wherever its blocks lie.
        let mesh = |slam: &mut Slam| slam.mesh(&mut |_, _| ()).expect("a mesh");
        let (of_all, of_both) = (mesh(&mut unbounded), mesh(&mut bounded));
        for (a, b) in [(&of_all, &of_both), (&of_both, &of_all)] {
            let near = share_near(&a.positions, &b.positions, 0.02);
            assert!(near >= 0.99, "{near} of the vertices are near the other mesh");
        }
        let camera = sequence.calibration().depth;
        let first = sequence.frames().next().and_then(|frame| frame.world_from_camera).expect("a pose");
        let seen = |slam: &mut Slam| {
            let from = slam.trajectory().poses().first().expect("a pose").world_from_camera;
            let picture = slam.render(&camera, &from, 4.0, Shading::Grey).expect("a picture");
            picture.data().iter().filter(|pixel| pixel[3] > 0).count()
        };
        let (a, b) = (seen(&mut unbounded), seen(&mut bounded));
        assert!(a > 10_000 && a.abs_diff(b) < 200, "{a} and {b} pixels from {first:?}");
        // Without swapping the same budget is too small, and says so.
        let mut off = settings(mode, budget);
        off.map.swapping = Swapping::Off;
        let mut full = start(&device, &sequence, &off, poses);
        assert!(process(&mut full, &sequence, 0..80));
    }
}

/// A disk that is full from the first block on: what left the device stays in memory, and the run goes on, saying so.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_loses_nothing_that_is_in_the_map() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Loop, (160, 120), 80);
    for (mode, poses, budget) in [
        (Mode::Basic, Poses::Given, 3.0),
        (Mode::LoopClosure, Poses::Given, 3.0),
        (Mode::LoopClosure, Poses::Tracked, 6.0),
    ] {
        let mut settings = settings(mode, budget);
        settings.map.host_budget_mib = 0.5;
        settings.map.host_file = "/dev/full".into();
        let mut slam = start(&device, &sequence, &settings, poses);
        let mut reasons = Vec::new();
        let mut stored = 0;
        for frame in sequence.frames() {
            let result = slam.process(&frame).expect("a result");
            let notices = result.report.into_iter().flat_map(|report| report.notices);
            reasons.extend(notices.filter_map(|notice| match notice {
                Notice::HostStore { reason } => Some(reason),
                _ => None,
            }));
            // Nothing more leaves, and nothing that did is lost: it comes back when it is seen.
            stored = slam.stored_blocks().max(stored);
        }
        check_submaps(&slam, poses);
        assert!(stored > 0 && reasons.len() > 10, "{stored} blocks were stored, and {} frames said", reasons.len());
        assert!(reasons.iter().all(|reason| reason.contains("/dev/full")), "{}", reasons[0]);
        assert_eq!(slam.trajectory().len(), 80);
        // Every block is still in the mesh: the part of the scene that the first frames saw is whole.
        let mut unbounded = start(&device, &sequence, &self::settings(mode, 0.0), poses);
        process(&mut unbounded, &sequence, 0..15);
        let first = unbounded.mesh(&mut |_, _| ()).expect("a mesh");
        let all = slam.mesh(&mut |_, _| ()).expect("a mesh");
        let near = share_near(&first.positions, &all.positions, 0.02);
        assert!(near > 0.99, "{near} of what was seen first is in the mesh");
    }
}

#[test]
fn tracking_against_projected_points_repeats_and_goes_on_after_a_save() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let sequence = sequence(Path::Loop, (160, 120), 40);
    for mode in MODES {
        let mut settings = settings(mode, 0.0);
        settings.tracker.forward_projection.enabled = true;
        // The camera moves by more than the report's 22 mm between frames of so short a way round.
        settings.tracker.forward_projection.max_move_m = 0.2;
        let mut whole = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut whole, &sequence, 0..40);
        check_submaps(&whole, Poses::Tracked);
        assert_eq!(whole.trajectory().len(), 40);
        let truth = sequence.frames().map(|frame| frame.world_from_camera.expect("a pose"));
        let first = sequence.frames().next().and_then(|frame| frame.world_from_camera).expect("a pose");
        for (found, truth) in whole.trajectory().poses().iter().zip(truth) {
            let error = (first.inverse() * truth).translation.distance(found.world_from_camera.translation);
            assert!(error < 0.02, "{error} m off at {:?}", found.timestamp);
        }
        let mut half = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut half, &sequence, 0..22);
        half.save(&folder.path().join("half.itm")).expect("saved");
        let mut second = Slam::resume(&device, &folder.path().join("half.itm")).expect("resumed");
        process(&mut second, &sequence, 22..40);
        assert!(second.trajectory() == whole.trajectory());
        // It is not the full raycast.
        settings.tracker.forward_projection.enabled = false;
        let mut full = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut full, &sequence, 0..40);
        assert!(full.trajectory() != whole.trajectory());
    }
}

/// The share of points that have one of others within a distance.
fn share_near(points: &[Vec3], others: &[Vec3], distance: f32) -> f64 {
    let cell = |p: Vec3| (p / distance).floor().as_ivec3();
    let mut cells: HashMap<IVec3, Vec<Vec3>> = HashMap::new();
    for other in others {
        cells.entry(cell(*other)).or_default().push(*other);
    }
    let near = |point: &&Vec3| {
        let around = (0..27).map(|i| cell(**point) + IVec3::new(i % 3, i / 3 % 3, i / 9) - 1);
        around.filter_map(|c| cells.get(&c)).flatten().any(|other| other.distance(**point) <= distance)
    };
    points.iter().filter(near).count() as f64 / points.len() as f64
}

#[test]
fn a_dense_volume_holds_the_same_surface() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 8);
    let mut hashed = start(&device, &sequence, &settings(Mode::Basic, 0.0), Poses::Given);
    process(&mut hashed, &sequence, 0..8);
    let expected = hashed.mesh(&mut |_, _| ()).expect("a mesh");
    let (lo, hi) = expected.bounds().expect("vertices");
    let mut dense = settings(Mode::Basic, 0.0);
    dense.map.index = MapIndex::Dense;
    let blocks = |v: f32| (v / 0.16).floor() as i32;
    let first = [blocks(lo.x) - 1, blocks(lo.y) - 1, blocks(lo.z) - 1];
    let last = [blocks(hi.x) + 1, blocks(hi.y) + 1, blocks(hi.z) + 1];
    dense.map.dense.offset = first.map(|block| 8 * block);
    dense.map.dense.size = std::array::from_fn(|i| 8 * (last[i] - first[i] + 1) as u32);
    let mut slam = start(&device, &sequence, &dense, Poses::Given);
    process(&mut slam, &sequence, 0..8);
    let found = slam.mesh(&mut |_, _| ()).expect("a mesh");
    let near = share_near(&expected.positions, &found.positions, 1e-5);
    assert!(near == 1.0, "{near} of the surface");
    // Half of the box: what lies outside is not kept, and nothing waits for it.
    dense.map.dense.size[0] = (dense.map.dense.size[0] / 16).max(1) * 8;
    let mut half = start(&device, &sequence, &dense, Poses::Given);
    assert!(!process(&mut half, &sequence, 0..8));
    let vertices = half.mesh(&mut |_, _| ()).expect("a mesh").positions.len();
    assert!(vertices > 0 && vertices < found.positions.len(), "{vertices} of {}", found.positions.len());
    // It tracks, too.
    dense.map.dense.offset = [-96, -96, -8];
    dense.map.dense.size = [192, 192, 224];
    let mut tracked = start(&device, &sequence, &dense, Poses::Tracked);
    process(&mut tracked, &sequence, 0..8);
    assert_eq!(tracked.trajectory().len(), 8);
}

/// Each submap of a dense map has the box in its own frame. Such a map is one to go on in and to start in, too.
#[test]
fn dense_volumes_are_submaps_and_saved_maps() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("dense.itm");
    let sequence = sequence(Path::Loop, (160, 120), 50);
    for mode in MODES {
        let mut settings = settings(mode, 0.0);
        settings.map.index = MapIndex::Dense;
        (settings.map.dense.offset, settings.map.dense.size) = ([-96, -96, -8], [192, 192, 224]);
        let mut whole = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut whole, &sequence, 0..50);
        check_submaps(&whole, Poses::Tracked);
        assert_eq!(whole.trajectory().len(), 50);
        let submaps = whole.submaps().len().max(1);
        assert_eq!(whole.saved_blocks().expect("the device answers"), submaps * 24 * 24 * 28);
        let mut first = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut first, &sequence, 0..40);
        first.save(&path).expect("saved");
        let mut second = Slam::resume(&device, &path).expect("resumed");
        process(&mut second, &sequence, 40..50);
        assert!(second.trajectory() == whole.trajectory(), "{mode:?}");
        settings.map.fuse = false;
        let mut found = Slam::in_map(&device, &sequence.calibration(), &settings, &path, Some(&Se3::IDENTITY))
            .expect("the map is taken in");
        assert_eq!(found.saved_blocks().expect("the device answers"), first.saved_blocks().expect("it answers"));
        for frame in sequence.frames().take(5) {
            assert_eq!(found.process(&frame).expect("a result").status, FrameStatus::Tracked, "frame {}", frame.index);
        }
        let mesh = |slam: &mut Slam| slam.mesh(&mut |_, _| ()).expect("a mesh").positions;
        let (was, is) = (mesh(&mut first), mesh(&mut found));
        assert!(
            share_near(&was, &is, 1e-5) == 1.0 && was.len() == is.len(),
            "{} vertices, then {}",
            was.len(),
            is.len()
        );
    }
}

/// A box before a wall that is carried away: with `map.empty_loss` its surface is forgotten and its blocks are freed.
#[test]
fn what_is_carried_away_disappears() {
    let Some(device) = device() else { return };
    let camera = Intrinsics::new(160, 120, 140.0, 140.0, 79.5, 59.5);
    let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
    let frame = |index: u64, there: bool| {
        let depth = Image::from_fn(160, 120, |x, y| {
            let on_box = there && (50..110).contains(&x) && (40..90).contains(&y);
            if on_box { 1.2_f32 } else { 2.0 }
        });
        let mut frame = Frame::new(index, Timestamp(index as i64 * 33_333_333), DepthImage::Metres(depth), None);
        frame.world_from_camera = Some(Se3::IDENTITY);
        frame
    };
    let run = |mode: Mode, empty_loss: u16, with_box: bool| {
        let mut settings = settings(mode, 0.0);
        settings.map.empty_loss = empty_loss;
        // Placed frames stay in the submap that there is; what is forgotten is forgotten where frames are fused.
        let poses = if mode == Mode::Basic { Poses::Given } else { Poses::Tracked };
        let mut slam = Slam::new(&device, &calibration, &settings, poses).expect("a map");
        let mut process = |frame: Frame| match poses {
            Poses::Given => slam.process(&frame).expect("a result"),
            Poses::Tracked => slam.place(&frame, &Se3::IDENTITY).expect("a result"),
        };
        (0..60).for_each(|i| drop(process(frame(i, with_box))));
        (60..95).for_each(|i| drop(process(frame(i, false))));
        assert_eq!(slam.submaps().len(), usize::from(mode == Mode::LoopClosure));
        let blocks = slam.saved_blocks().expect("the device answers");
        let mesh = slam.mesh(&mut |_, _| ()).expect("a mesh");
        let on_box = mesh.positions.iter().filter(|p| p.z < 1.6).count();
        let on_wall = mesh.positions.iter().filter(|p| p.z > 1.9).count();
        (blocks, on_box, on_wall)
    };
    for mode in MODES {
        let (blocks, on_box, on_wall) = run(mode, 10, true);
        assert_eq!(on_box, 0, "the box is still there");
        assert!(on_wall > 2_000, "{on_wall} vertices on the wall");
        let (of_wall, ..) = run(mode, 10, false);
        assert!(blocks < of_wall + 6, "{blocks} blocks, {of_wall} where there never was a box");
        let (with_box, on_box, _) = run(mode, 0, true);
        assert!(on_box > 200 && with_box > of_wall + 10, "{on_box} vertices, {with_box} blocks but {of_wall}");
    }
}

#[test]
fn a_folder_that_no_block_can_be_written_to_is_refused_at_once() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 2);
    for mode in MODES {
        let mut settings = settings(mode, 1.0);
        settings.map.host_folder = "/nowhere/at/all".into();
        let error = Slam::new(&device, &sequence.calibration(), &settings, Poses::Tracked).expect_err("refused");
        assert!(error.to_string().contains("/nowhere/at/all"), "{error}");
        settings.map.host_file = "/nowhere/at/all.blocks".into();
        let error = Slam::new(&device, &sequence.calibration(), &settings, Poses::Tracked).expect_err("refused");
        assert!(error.to_string().contains("/nowhere/at/all.blocks"), "{error}");
    }
}

/// What is deleted of submaps may be all of one: the camera is not looked for there any more, and that is said.
#[test]
fn deleted_blocks_make_room_for_ever() {
    let Some(device) = device() else { return };
    for (mode, poses, budget, frames) in
        [(Mode::Basic, Poses::Given, 3.0, 80), (Mode::LoopClosure, Poses::Tracked, 6.0, 160)]
    {
        let sequence = sequence(Path::Loop, (160, 120), frames);
        let mut settings = settings(mode, budget);
        settings.map.swapping = Swapping::Delete;
        let mut slam = start(&device, &sequence, &settings, poses);
        assert!(!process(&mut slam, &sequence, 0..frames as usize));
        check_submaps(&slam, poses);
        assert_eq!(slam.stored_blocks(), 0);
        assert_eq!(slam.trajectory().len(), frames as usize);
        let there: Vec<u16> = slam.blocks().expect("keys").into_iter().map(|key| key.submap).collect();
        let mut gone = Vec::new();
        while let Some(warning) = slam.next_warning() {
            let Warning::SubmapWithoutBlocks { submap, .. } = warning else { panic!("{warning}") };
            assert!(!there.contains(&submap), "{warning}");
            assert!(slam.keyframes().iter().all(|keyframe| keyframe.submap != submap));
            gone.push(submap);
        }
        assert_eq!(gone.is_empty(), mode == Mode::Basic, "{gone:?} of {} submaps", slam.submaps().len());
        // All that looks at the map goes on.
        assert!(!slam.mesh(&mut |_, _| ()).expect("a mesh").is_empty());
        let camera = sequence.calibration().depth;
        let last = slam.corrected_trajectory().poses().last().expect("a pose").world_from_camera;
        slam.render(&camera, &last, 4.0, Shading::Grey).expect("a picture");
    }
}

#[test]
fn a_camera_is_found_in_a_saved_map_without_changing_it() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("room.itm");
    for (mode, poses, kind, frames) in
        [(Mode::Basic, Poses::Given, Path::Arc, 20), (Mode::LoopClosure, Poses::Tracked, Path::Loop, 60)]
    {
        let sequence = sequence(kind, (160, 120), frames);
        let mut slam = start(&device, &sequence, &settings(mode, 0.0), poses);
        process(&mut slam, &sequence, 0..frames as usize);
        check_submaps(&slam, poses);
        slam.save(&path).expect("saved");
        // The map is found where it was made: its own drift is not what this asks for.
        let of_map: Vec<Se3> = slam.corrected_trajectory().poses().iter().map(|pose| pose.world_from_camera).collect();
        for swapping in [Swapping::Host, Swapping::Off] {
            let mut looking = settings(mode, 0.0);
            looking.map.fuse = false;
            looking.map.swapping = swapping;
            // A little beside the pose.
            let beside = of_map[5] * Se3::exp([0.02, -0.01, 0.02, 0.01, -0.02, 0.01]);
            let mut found = Slam::in_map(&device, &sequence.calibration(), &looking, &path, Some(&beside))
                .expect("the map is taken in");
            let before = found.saved_blocks().expect("the device answers");
            assert!(before > 100, "{before} blocks");
            let submaps: Vec<Se3> = found.submaps().iter().map(|submap| submap.world_from_submap).collect();
            let mut been_in = BTreeSet::new();
            for (frame, expected) in sequence.frames().zip(&of_map).skip(5) {
                let result = found.process(&frame).expect("a result");
                assert_eq!(result.status, FrameStatus::Tracked, "frame {}", frame.index);
                assert!(!result.fused);
                let error = (expected.inverse() * result.world_from_camera.expect("a pose")).translation.length();
                assert!(error < 0.01, "frame {} is {error} m off", frame.index);
                been_in.insert(result.submap);
            }
            assert_eq!(found.saved_blocks().expect("the device answers"), before);
            assert!(found.settle().is_none());
            let after: Vec<Se3> = found.submaps().iter().map(|submap| submap.world_from_submap).collect();
            assert_eq!(after, submaps, "the submaps stay where they are");
            // It goes on from one to the next.
            assert_eq!(been_in.len() > 1, mode == Mode::LoopClosure, "{been_in:?} of {} submaps", submaps.len());
        }
        // Another size of voxels is another map.
        let mut other = settings(mode, 0.0);
        other.map.voxel_size_m = 0.01;
        let error =
            Slam::in_map(&device, &sequence.calibration(), &other, &path, Some(&Se3::IDENTITY)).expect_err("refused");
        assert!(error.to_string().contains("voxel_size_m 0.02, but the settings say 0.01"), "{error}");
    }
}
