//! Maps that are saved and loaded, and maps that do not all lie on the device.

use itm_slam::{Device, FrameStatus, Notice, Poses, SavedSession, Se3, Settings, Slam, Swapping, Trajectory};
use itm_synth::{Path, Sequence};
use itm_tests::{device, sequence};

/// Small voxels' worth of map for small images.
fn settings(device_budget_mib: f64) -> Settings {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    settings.map.device_budget_mib = device_budget_mib;
    settings
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
    for (budget, poses) in [(0.0, Poses::Tracked), (2.0, Poses::Given)] {
        let settings = settings(budget);
        let mut whole = start(&device, &sequence, &settings, poses);
        process(&mut whole, &sequence, 0..60);
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
        assert!(second.trajectory() == whole.trajectory(), "another trajectory with a budget of {budget} MiB");
        let bytes = |name: &str| std::fs::read(at(name)).expect("it was written");
        assert!(bytes("second.itm") == bytes("whole.itm"), "another map with a budget of {budget} MiB");

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
    for poses in [Poses::Given, Poses::Tracked] {
        let mut unbounded = start(&device, &sequence, &settings(0.0), poses);
        assert!(!process(&mut unbounded, &sequence, 0..80));
        let bytes = unbounded.map_bytes();
        let mut bounded = start(&device, &sequence, &settings(3.0), poses);
        assert!(!process(&mut bounded, &sequence, 0..80), "blocks found no room");
        assert!(bounded.stored_blocks() > 0, "all blocks fit the budget");
        assert!(bounded.map_bytes() < bytes, "{} and {bytes} bytes", bounded.map_bytes());
        let apart = apart(unbounded.trajectory(), bounded.trajectory());
        assert!(apart < 1e-3, "{apart} m apart");
        // Without swapping the same budget is too small, and says so.
        let mut off = settings(3.0);
        off.map.swapping = Swapping::Off;
        let mut full = start(&device, &sequence, &off, poses);
        assert!(process(&mut full, &sequence, 0..80));
    }
}

#[test]
fn deleted_blocks_make_room_for_ever() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Loop, (160, 120), 80);
    let mut settings = settings(3.0);
    settings.map.swapping = Swapping::Delete;
    let mut slam = start(&device, &sequence, &settings, Poses::Given);
    assert!(!process(&mut slam, &sequence, 0..80));
    assert_eq!(slam.stored_blocks(), 0);
}

#[test]
fn a_camera_is_found_in_a_saved_map_without_changing_it() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let sequence = sequence(Path::Arc, (160, 120), 20);
    let truth: Vec<Se3> = sequence.frames().map(|frame| frame.world_from_camera.expect("a pose")).collect();
    let mut slam = start(&device, &sequence, &settings(0.0), Poses::Given);
    process(&mut slam, &sequence, 0..20);
    let path = folder.path().join("room.itm");
    slam.save(&path).expect("saved");
    for swapping in [Swapping::Host, Swapping::Off] {
        let mut looking = settings(0.0);
        looking.map.fuse = false;
        looking.map.swapping = swapping;
        // A little beside the true pose.
        let beside = truth[5] * Se3::exp([0.02, -0.01, 0.02, 0.01, -0.02, 0.01]);
        let mut found =
            Slam::in_map(&device, &sequence.calibration(), &looking, &path, &beside).expect("the map is taken in");
        let before = found.saved_blocks().expect("the device answers");
        assert!(before > 100, "{before} blocks");
        for (frame, truth) in sequence.frames().zip(&truth).skip(5) {
            let result = found.process(&frame).expect("a result");
            assert_eq!(result.status, FrameStatus::Tracked, "frame {}", frame.index);
            assert!(!result.fused);
            let error = (truth.inverse() * result.world_from_camera.expect("a pose")).translation.length();
            assert!(error < 0.01, "frame {} is {error} m off", frame.index);
        }
        assert_eq!(found.saved_blocks().expect("the device answers"), before);
    }
    // Another size of voxels is another map.
    let mut other = settings(0.0);
    other.map.voxel_size_m = 0.01;
    let error = Slam::in_map(&device, &sequence.calibration(), &other, &path, &Se3::IDENTITY).expect_err("refused");
    assert!(error.to_string().contains("voxel_size_m 0.02, but the settings say 0.01"), "{error}");
}
