//! Maps of surfels, in whole runs.

use glam::Vec3;
use itm_slam::evaluation::{DEFAULT_TOLERANCE_NS, evaluate};
use itm_slam::surfel::Surfel;
use itm_slam::{
    Device, Error, FrameStatus, Happening, Mode, Notice, Poses, SavedSession, Se3, Settings, Shading, Slam,
};
use itm_synth::{DepthNoise, Path, Sequence, Spec};
use itm_tests::surface::{Views, completeness, quantile};
use itm_tests::{device, sequence};

fn settings() -> Settings {
    let mut settings = Settings { mode: Mode::Surfels, ..Settings::default() };
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.tracker.extended.levels = "bbb".into();
    settings
}

fn start(device: &Device, sequence: &Sequence, settings: &Settings, poses: Poses) -> Slam {
    Slam::new(device, &sequence.calibration(), settings, poses).expect("a small map fits")
}

/// Processes frames; whether any surfels found no room.
fn process(slam: &mut Slam, sequence: &Sequence, frames: std::ops::Range<usize>) -> bool {
    let mut full = false;
    for frame in sequence.frames().skip(frames.start).take(frames.len()) {
        let result = slam.process(&frame).expect("a result");
        let notices = result.report.into_iter().flat_map(|report| report.notices);
        full |= notices.into_iter().any(|notice| matches!(notice, Notice::SurfelsDropped { .. }));
    }
    full
}

fn ate_m(slam: &Slam, truth: &Sequence) -> f64 {
    let evaluation = evaluate(slam.trajectory(), &truth.trajectory(), DEFAULT_TOLERANCE_NS);
    evaluation.expect("poses to compare").ate.rmse
}

fn noisy(sequence: &Sequence) -> Sequence {
    Sequence::new((*sequence.spec()).with_noise(DepthNoise::KINECT, 3)).expect("a valid specification")
}

#[test]
fn surfels_of_given_poses_lie_on_the_true_surface_and_their_mesh_covers_it() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (320, 240), 60);
    let mut settings = settings();
    settings.map.voxel_size_m = 0.01;
    settings.map.truncation_m = 0.04;
    let mut slam = start(&device, &sequence, &settings, Poses::Given);
    assert!(!process(&mut slam, &sequence, 0..60));
    let surfels = slam.surfels().expect("the device answers");
    assert!(surfels.len() > 20_000, "{} surfels", surfels.len());
    let distance = |surfel: &Surfel| sequence.scene().distance(surfel.position).abs();
    let off: Vec<f32> = surfels.iter().map(distance).collect();
    let (median, most) = (quantile(&off, 0.5), quantile(&off, 0.95));
    println!("{} surfels: median {:.3} mm, 95 % within {:.3} mm", off.len(), median * 1e3, most * 1e3);
    assert!(median < 1e-3, "median {median} m");
    assert!(most < 8e-3, "95 % within {most} m");
    assert!(surfels.iter().all(|surfel| surfel.colour.is_some() && surfel.radius_m > 0.0));
    // One a pixel, and what the camera's way adds.
    assert!(surfels.len() < 3 * 320 * 240, "{} surfels", surfels.len());
    let mesh = slam.mesh(&mut |_, _| ()).expect("a mesh");
    let views = Views::new(&sequence, [settings.view.min_depth_m, settings.view.max_depth_m]);
    // Seen so often, even what lies in the images' corners is stable.
    let covered = completeness(&mesh, &views.surface_points(9, 40), 0.01);
    println!("{:.1} % covered", covered * 100.0);
    assert!(covered > 0.95, "{covered} of the surface covered");
}

#[test]
fn the_camera_is_tracked_as_well_as_against_voxels() {
    let Some(device) = device() else { return };
    for sequence in [sequence(Path::Arc, (160, 120), 30), noisy(&sequence(Path::Arc, (160, 120), 30))] {
        let ate = |mode: Mode| {
            let settings = Settings { mode, ..settings() };
            let mut slam = start(&device, &sequence, &settings, Poses::Tracked);
            process(&mut slam, &sequence, 0..30);
            assert_eq!(slam.trajectory().len(), 30);
            ate_m(&slam, &sequence)
        };
        let (surfels, voxels) = (ate(Mode::Surfels), ate(Mode::Basic));
        println!("ATE {:.2} mm with surfels, {:.2} mm with voxels", surfels * 1e3, voxels * 1e3);
        assert!(surfels < (1.1 * voxels).max(voxels + 2e-3), "{surfels} and {voxels} m");
    }
}

#[test]
fn runs_repeat_and_go_on_after_a_save_to_the_same_bytes() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let bytes = |name: &str| std::fs::read(at(name)).expect("it was written");
    let sequence = noisy(&sequence(Path::Loop, (160, 120), 60));
    let mut settings = settings();
    settings.surfels.initial = 1000;
    for name in ["whole.itm", "again.itm"] {
        let mut slam = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut slam, &sequence, 0..60);
        slam.save(&at(name)).expect("saved");
    }
    assert!(bytes("whole.itm") == bytes("again.itm"), "another map");
    let mut first = start(&device, &sequence, &settings, Poses::Tracked);
    process(&mut first, &sequence, 0..37);
    first.save(&at("half.itm")).expect("saved");
    assert_eq!(SavedSession::open(&at("half.itm")).expect("a session").settings.mode, Mode::Surfels);
    let mut second = Slam::resume(&device, &at("half.itm")).expect("resumed");
    process(&mut second, &sequence, 37..60);
    second.save(&at("second.itm")).expect("saved");
    assert!(bytes("second.itm") == bytes("whole.itm"), "another map after a save");
    // Saving has changed nothing.
    process(&mut first, &sequence, 37..60);
    first.save(&at("first.itm")).expect("saved");
    assert!(bytes("first.itm") == bytes("whole.itm"));
}

#[test]
fn submaps_of_surfels_close_a_loop_and_are_one_map() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    // Once around the room in 240 frames and on: the camera comes back to where it began.
    let spec = Spec::new(Path::Loop).with_size(160, 120).with_noise(DepthNoise::KINECT, 5).with_frames(290);
    let sequence = Sequence::new(Spec { duration_s: 8.0, ..spec }).expect("a valid specification");
    let settings = Settings { mode: Mode::SurfelsLoopClosure, ..Settings::default() };
    let mut slam = start(&device, &sequence, &settings, Poses::Tracked);
    let mut happened = Vec::new();
    for (index, frame) in sequence.frames().enumerate() {
        happened.extend(slam.process(&frame).expect("a result").happenings);
        // A closure is on trial.
        if index == 259 {
            slam.save(&at("half.itm")).expect("saved");
        }
    }
    slam.save(&at("whole.itm")).expect("saved");
    let count = |what: fn(&Happening) -> bool| happened.iter().filter(|h| what(h)).count();
    assert!(count(|h| matches!(h, Happening::Submap { .. })) >= 3, "{happened:?}");
    assert!(count(|h| matches!(h, Happening::ClosureAccepted { to: 0, .. })) >= 1, "{happened:?}");
    let mut resumed = Slam::resume(&device, &at("half.itm")).expect("resumed");
    process(&mut resumed, &sequence, 260..290);
    resumed.save(&at("resumed.itm")).expect("saved");
    assert!(
        std::fs::read(at("resumed.itm")).expect("it is there") == std::fs::read(at("whole.itm")).expect("it is there")
    );

    slam.settle();
    let corrected = slam.corrected_trajectory();
    assert_eq!(corrected.len(), 290);
    let ate = evaluate(&corrected, &sequence.trajectory(), DEFAULT_TOLERANCE_NS).expect("poses to compare").ate.rmse;
    println!("ATE {:.2} mm", ate * 1e3);
    assert!(ate < 0.008, "{ate} m");
    // The surfels of all submaps lie in the world, where the scene is, as do pictures and meshes.
    let surfels = slam.surfels().expect("the device answers");
    // The session's world begins at the first camera.
    let scene_from_world =
        sequence.trajectory().poses()[0].world_from_camera * corrected.poses()[0].world_from_camera.inverse();
    let off =
        |point: Vec3| sequence.scene().distance(scene_from_world.transform_point(point.as_dvec3()).as_vec3()).abs();
    let of_surfels: Vec<f32> = surfels.iter().map(|surfel| off(surfel.position)).collect();
    assert!(surfels.iter().any(|surfel| surfel.submap > 2));
    let mesh = slam.mesh(&mut |_, _| ()).expect("a mesh");
    let of_mesh: Vec<f32> = mesh.positions.iter().map(|point| off(*point)).collect();
    let medians = [quantile(&of_surfels, 0.5), quantile(&of_mesh, 0.5)];
    println!("median distances {medians:?} m");
    assert!(medians.iter().all(|median| *median < 0.012), "{medians:?}");
    let camera = sequence.calibration().depth;
    let picture =
        slam.render(&camera, &corrected.poses()[110].world_from_camera, 4.0, Shading::Colour).expect("a picture");
    let shown = picture.data().iter().filter(|pixel| pixel[3] > 0).count();
    assert!(shown > 12_000, "{shown} of 19200 pixels");
}

#[test]
fn a_camera_is_found_in_a_saved_map_of_surfels_and_no_other() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("room.itm");
    let sequence = sequence(Path::Arc, (160, 120), 40);
    let mut slam = start(&device, &sequence, &settings(), Poses::Given);
    process(&mut slam, &sequence, 0..40);
    slam.save(&path).expect("saved");
    let before = slam.surfels().expect("the device answers").len();
    let mut looking = settings();
    looking.map.fuse = false;
    let mut found = Slam::in_map(&device, &sequence.calibration(), &looking, &path, None).expect("taken in");
    for frame in sequence.frames().skip(10).take(20) {
        let truth = frame.world_from_camera.expect("a pose");
        let result = found.process(&frame).expect("a result");
        assert!(matches!(result.status, FrameStatus::Tracked | FrameStatus::Poor { .. }), "{:?}", result.status);
        let off = truth.inverse() * result.world_from_camera.expect("a pose");
        assert!(off.translation.length() < 0.01, "frame {} is {} m off", frame.index, off.translation.length());
    }
    assert_eq!(found.surfels().expect("the device answers").len(), before);
    // Neither kind of map is taken for the other.
    let voxels = Settings { mode: Mode::Basic, ..settings() };
    let error =
        Slam::in_map(&device, &sequence.calibration(), &voxels, &path, Some(&Se3::IDENTITY)).expect_err("refused");
    assert!(matches!(error, Error::OtherMap { .. }) && error.to_string().contains("surfels"), "{error}");
    let mut slam = start(&device, &sequence, &voxels, Poses::Given);
    process(&mut slam, &sequence, 0..3);
    slam.save(&path).expect("saved");
    let error =
        Slam::in_map(&device, &sequence.calibration(), &looking, &path, Some(&Se3::IDENTITY)).expect_err("refused");
    assert!(error.to_string().contains("a map of voxels, but the settings say surfels"), "{error}");
}

#[test]
fn a_full_map_says_so_and_the_camera_is_tracked_on() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Loop, (160, 120), 80);
    let mut settings = settings();
    settings.surfels.device_budget_mib = 1.0;
    let mut slam = start(&device, &sequence, &settings, Poses::Tracked);
    assert!(process(&mut slam, &sequence, 0..80), "no frame says that the map is full");
    let limit = (1024.0 * 1024.0 / 44.0) as usize;
    assert!(slam.surfels().expect("the device answers").len() <= limit);
    // What was seen first is still there.
    let camera = sequence.calibration().depth;
    let picture = slam.render(&camera, &Se3::IDENTITY, 4.0, Shading::Grey).expect("a picture");
    let seen = picture.data().iter().filter(|pixel| pixel[3] > 0).count();
    assert!(seen > 8_000, "{seen} pixels show something");
    assert!(slam.trajectory().len() > 20);
}

#[test]
fn recordings_without_colour_make_surfels_without() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 25);
    let mut slam = start(&device, &sequence, &settings(), Poses::Given);
    for mut frame in sequence.frames() {
        frame.colour = None;
        slam.process(&frame).expect("a result");
    }
    let surfels = slam.surfels().expect("the device answers");
    assert!(!surfels.is_empty() && surfels.iter().all(|surfel| surfel.colour.is_none()));
}

#[test]
fn the_surfels_colours_help_to_track_where_depth_says_nothing() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Wall, (160, 120), 30);
    let ate = |use_map_colour| {
        let mut settings = settings();
        settings.tracker.extended.levels = "rrbb".into();
        settings.tracker.extended.use_map_colour = use_map_colour;
        let mut slam = start(&device, &sequence, &settings, Poses::Tracked);
        process(&mut slam, &sequence, 0..30);
        ate_m(&slam, &sequence)
    };
    let (with, without) = (ate(true), ate(false));
    println!("ATE {:.2} mm with the map's colours, {:.2} mm with those of the frame before", with * 1e3, without * 1e3);
    assert!(with < 0.02, "{with} m");
}

#[test]
fn settings_that_surfels_cannot_meet_are_refused() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 2);
    let mut unfit = settings();
    unfit.tracker.forward_projection.enabled = true;
    let error = Slam::new(&device, &sequence.calibration(), &unfit, Poses::Tracked).expect_err("refused");
    assert!(error.to_string().contains("forward_projection"), "{error}");
    let mut unfit = settings();
    unfit.surfels.radius_factor = 0.0;
    let error = Slam::new(&device, &sequence.calibration(), &unfit, Poses::Tracked).expect_err("refused");
    assert!(error.to_string().contains("surfels.radius_factor"), "{error}");
}
