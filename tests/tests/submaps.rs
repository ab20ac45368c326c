//! Maps of submaps: loops are closed, places are found again, and what works with one map works with many.

use itm_slam::{
    Device, Frame, FrameStatus, Happening, Mode, Poses, SavedMap, SavedSession, Settings, Shading, Slam, StampedPose,
    SubmapState, Trajectory,
};
use itm_synth::{DepthNoise, Path, Sequence, Spec};
use itm_tests::{device, small_map};

/// Processes frames; what happened.
fn process(slam: &mut Slam, sequence: &Sequence, frames: std::ops::Range<usize>) -> Vec<Happening> {
    let mut happened = Vec::new();
    for frame in sequence.frames().skip(frames.start).take(frames.len()) {
        happened.extend(slam.process(&frame).expect("a result").happenings);
    }
    happened
}

fn start(device: &Device, sequence: &Sequence, settings: &Settings) -> Slam {
    Slam::new(device, &sequence.calibration(), settings, Poses::Tracked).expect("a small map fits")
}

/// The root mean square of a trajectory's distances from the truth.
fn ate_m(slam: &Slam, sequence: &Sequence) -> f64 {
    let truth = |frame: Frame| StampedPose {
        timestamp: frame.timestamp,
        world_from_camera: frame.world_from_camera.expect("a pose"),
    };
    let truth: Trajectory = sequence.frames().map(truth).collect();
    let found = slam.corrected_trajectory();
    assert_eq!(found.len(), truth.len(), "every frame has a pose");
    itm_slam::evaluation::evaluate(&found, &truth, 0).expect("poses of the same times").ate.rmse
}

/// Once around the room in 240 frames and on: the camera comes back to where it began.
fn around(frames: u32) -> Sequence {
    let spec = Spec::new(Path::Loop).with_size(160, 120).with_noise(DepthNoise::KINECT, 5).with_frames(frames);
    Sequence::new(Spec { duration_s: 8.0, ..spec }).expect("a valid specification")
}

#[test]
fn a_loop_is_closed_and_two_runs_give_the_same_bytes() {
    let Some(device) = device() else { return };
    let sequence = around(290);
    let folder = tempfile::tempdir().expect("a folder");
    let run = |name: &str| {
        let mut slam = start(&device, &sequence, &small_map(Mode::LoopClosure));
        let happened = process(&mut slam, &sequence, 0..290);
        slam.save(&folder.path().join(name)).expect("saved");
        (slam, happened)
    };
    let (mut slam, happened) = run("one.itm");
    let count = |what: fn(&Happening) -> bool| happened.iter().filter(|h| what(h)).count();
    assert!(count(|h| matches!(h, Happening::Submap { .. })) >= 3, "{happened:?}");
    assert!(count(|h| matches!(h, Happening::ClosureAccepted { to: 0, .. })) >= 1, "{happened:?}");
    assert!(count(|h| matches!(h, Happening::Optimised(_))) >= 3, "{happened:?}");
    assert!(slam.submaps().iter().filter(|submap| submap.state == SubmapState::Primary).count() == 1);
    assert!(slam.submap_links().iter().any(|link| link.closure));

    let (again, happened_again) = run("two.itm");
    assert_eq!(happened, happened_again);
    assert!(slam.trajectory() == again.trajectory());
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).expect("it was written");
    assert!(bytes("one.itm") == bytes("two.itm"));

    // Where the camera was lies better for it.
    let mut basic = start(&device, &sequence, &small_map(Mode::Basic));
    process(&mut basic, &sequence, 0..290);
    slam.settle();
    let (closed, open) = (ate_m(&slam, &sequence), ate_m(&basic, &sequence));
    assert!(closed < 0.006 && closed < 0.5 * open, "{closed} m with closures, {open} m without");

    // All submaps are one map for meshes and pictures, in the session as from the file.
    let mesh = slam.mesh(&mut |_, _| ()).expect("a mesh");
    let of_basic = basic.mesh(&mut |_, _| ()).expect("a mesh");
    let (lo, hi) = mesh.bounds().expect("vertices");
    let (basic_lo, basic_hi) = of_basic.bounds().expect("vertices");
    assert!(lo.distance(basic_lo) < 0.3 && hi.distance(basic_hi) < 0.3, "{lo} to {hi}, but {basic_lo} to {basic_hi}");
    // So they are for questions about distances: a mesh's vertices lie on the surface, in the world.
    let some: Vec<_> = mesh.positions.iter().step_by(mesh.positions.len() / 500).copied().collect();
    let known: Vec<f32> = slam.distances(&some).expect("an answer").into_iter().flatten().collect();
    let near = known.iter().filter(|metres| metres.abs() < 0.01).count();
    assert!(known.len() > some.len() * 9 / 10 && near > known.len() * 95 / 100, "{near} of {}", known.len());
    let camera = sequence.calibration().depth;
    let pose = slam.corrected_trajectory().poses()[110].world_from_camera;
    let picture = slam.render(&camera, &pose, 4.0, Shading::Colour).expect("a picture");
    let shown = picture.data().iter().filter(|pixel| pixel[3] > 0).count();
    assert!(shown > 12_000, "{shown} of 19200 pixels");
    let mut saved = SavedMap::open(&folder.path().join("one.itm"), 64 << 20, &mut |_, _| ()).expect("a map");
    assert_eq!(saved.submap_poses().expect("poses").len(), slam.submaps().len());
    let from_file = saved.mesh(&device, &Default::default(), &mut |_, _| ()).expect("a mesh");
    let (vertices, of_file) = (mesh.positions.len(), from_file.positions.len());
    assert!(vertices.abs_diff(of_file) < vertices / 50, "{vertices} and {of_file} vertices");
}

#[test]
fn a_session_of_submaps_goes_on_as_if_it_had_never_stopped() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let sequence = around(290);
    // Saved while two submaps are tracked and an optimisation is on its way, with blocks on the host too.
    let mut settings = small_map(Mode::LoopClosure);
    settings.map.device_budget_mib = 6.0;
    let mut whole = start(&device, &sequence, &settings);
    process(&mut whole, &sequence, 0..90);
    whole.save(&at("whole.itm")).expect("saved");
    for stop in [37, 68] {
        let mut first = start(&device, &sequence, &settings);
        process(&mut first, &sequence, 0..stop);
        first.save(&at("half.itm")).expect("saved");
        assert_eq!(SavedSession::open(&at("half.itm")).expect("a session").next_frame, stop as u64);
        let mut second = Slam::resume(&device, &at("half.itm")).expect("resumed");
        process(&mut second, &sequence, stop..90);
        second.save(&at("second.itm")).expect("saved");
        assert!(second.trajectory() == whole.trajectory(), "another trajectory after {stop} frames");
        let bytes = |name: &str| std::fs::read(at(name)).expect("it was written");
        assert!(bytes("second.itm") == bytes("whole.itm"), "another map after {stop} frames");
    }
}

#[test]
fn a_kidnapped_camera_and_one_in_a_saved_map_are_found() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("room.itm");
    let spec = Spec { duration_s: 12.0, ..Spec::new(Path::Kidnapped).with_size(160, 120).with_frames(360) };
    let kidnapped = Sequence::new(spec).expect("a valid specification");
    for mode in [Mode::Basic, Mode::LoopClosure] {
        let mut slam = start(&device, &kidnapped, &small_map(mode));
        let (mut lost, mut found, mut after) = (0, 0, Vec::new());
        let first = kidnapped.frames().next().and_then(|frame| frame.world_from_camera).expect("a pose");
        for frame in kidnapped.frames() {
            let result = slam.process(&frame).expect("a result");
            lost += usize::from(matches!(result.status, FrameStatus::Lost { .. }));
            found += result.happenings.iter().filter(|h| matches!(h, Happening::Relocalised { .. })).count();
            if found > 0 && result.status == FrameStatus::Tracked {
                let truth = first.inverse() * frame.world_from_camera.expect("a pose");
                let pose = result.world_from_camera.expect("it is tracked");
                after.push(truth.translation.distance(pose.translation));
            }
        }
        assert!(lost > 50 && found > 0, "{lost} frames were lost, {found} times found again");
        assert!(after.len() > 60, "{} frames after that are tracked", after.len());
        let worst = after.iter().copied().fold(0.0, f64::max);
        assert!(worst < 0.05, "{worst} m off after it was found again");
        slam.save(&path).expect("saved");

        // In the saved map, from a frame in the middle, without a word about where that is.
        let mut looking = small_map(mode);
        looking.map.fuse = false;
        let mut there = Slam::in_map(&device, &kidnapped.calibration(), &looking, &path, None).expect("taken in");
        let begin = 40;
        let results: Vec<_> = kidnapped
            .frames()
            .skip(begin)
            .take(30)
            .map(|frame| (there.process(&frame).expect("a result"), frame))
            .collect();
        let posed = results.iter().filter(|(result, _)| result.world_from_camera.is_some()).count();
        assert!(posed > 20, "{posed} of 30 frames have a pose");
        for (result, frame) in &results {
            let Some(pose) = result.world_from_camera else { continue };
            let truth = first.inverse() * frame.world_from_camera.expect("a pose");
            let off = truth.translation.distance(pose.translation);
            assert!(off < 0.05, "frame {} is {off} m off", frame.index);
        }
    }
}
