//! Whole runs on synthetic recordings, whose poses and surface are known exactly.

use itm_slam::evaluation::{DEFAULT_TOLERANCE_NS, evaluate};
use itm_slam::{DepthImage, FrameStatus, Image, Poses, Settings, Slam, StampedPose};
use itm_synth::{DepthNoise, Path, Sequence, Spec};
use itm_tests::surface::{Views, accuracy_m, completeness, quantile};
use itm_tests::{InMemory, Run, device, run, sequence};

/// Settings for images of 160x120: voxels about as wide as the pixels' footprint at 2 m.
fn small() -> Settings {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    settings.tracker.extended.levels = "bbb".into();
    settings
}

fn ate_m(run: &mut Run, truth: &Sequence) -> f64 {
    let evaluation = evaluate(run.session.slam_mut().trajectory(), &truth.trajectory(), DEFAULT_TOLERANCE_NS);
    evaluation.expect("poses to compare").ate.rmse
}

#[test]
fn a_mesh_fused_from_given_poses_lies_on_the_true_surface_and_covers_it() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (320, 240), 20);
    let mut settings = small();
    settings.map.voxel_size_m = 0.01;
    settings.map.truncation_m = 0.04;
    let mut run = run(&device, Box::new(InMemory::new(sequence.clone())), &settings, Poses::Given);
    assert_eq!(run.summary.posed, 20);
    let mesh = run.session.mesh(&mut |_, _| ()).expect("a mesh");
    assert_eq!(mesh.colours.len(), mesh.positions.len());

    let views = Views::new(&sequence, [settings.view.min_depth_m, settings.view.max_depth_m]);
    let errors = accuracy_m(&mesh, sequence.scene(), &views);
    let voxel = settings.map.voxel_size_m;
    let (median, most) = (quantile(&errors, 0.5), quantile(&errors, 0.99));
    let points = views.surface_points(9, 3);
    let covered = completeness(&mesh, &points, voxel);
    println!(
        "{} vertices: median {:.3}, 99 % within {:.3} voxels; {} points: {:.2} % covered",
        errors.len(),
        median / voxel,
        most / voxel,
        points.len(),
        100.0 * covered
    );
    assert!(errors.len() > 10_000 && points.len() > 1000);
    assert!(median < 0.2 * voxel, "median error {median} m");
    assert!(most < voxel, "99th percentile of the error {most} m");
    assert!(covered >= 0.97, "{covered} of the surface covered");
}

#[test]
fn an_arc_is_tracked_without_noise_and_with_it() {
    let Some(device) = device() else { return };
    let exact = sequence(Path::Arc, (160, 120), 30);
    let noisy = Sequence::new((*exact.spec()).with_noise(DepthNoise::KINECT, 3)).expect("a valid specification");
    for (sequence, limit_m) in [(exact, 0.01), (noisy, 0.03)] {
        let mut run = run(&device, Box::new(InMemory::new(sequence.clone())), &small(), Poses::Tracked);
        assert_eq!((run.summary.posed, run.summary.lost), (30, 0));
        let ate = ate_m(&mut run, &sequence);
        println!("ATE {:.1} mm", ate * 1e3);
        assert!(ate < limit_m, "ATE {ate} m");
    }
}

#[test]
fn two_runs_give_the_same_bytes() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 12);
    let results: Vec<(Vec<StampedPose>, itm_slam::Mesh)> = (0..2)
        .map(|_| {
            let mut run = run(&device, Box::new(InMemory::new(sequence.clone())), &small(), Poses::Tracked);
            let mesh = run.session.mesh(&mut |_, _| ()).expect("a mesh");
            (run.session.slam_mut().trajectory().poses().to_vec(), mesh)
        })
        .collect();
    assert!(results[0] == results[1], "two runs differ");
}

#[test]
fn a_small_pool_grows_and_nothing_is_lost() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 8);
    let mut meshes = Vec::new();
    for initial_blocks in [1, 8192] {
        let mut settings = small();
        settings.map.initial_blocks = initial_blocks;
        let mut run = run(&device, Box::new(InMemory::new(sequence.clone())), &settings, Poses::Given);
        assert!(run.reports().all(|r| r.notices.is_empty()), "every frame found room");
        meshes.push(run.session.mesh(&mut |_, _| ()).expect("a mesh"));
    }
    assert!(meshes[0] == meshes[1], "the pool's first size shows in the mesh");
}

#[test]
fn a_full_pool_is_said_and_the_run_goes_on() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 6);
    let mut settings = small();
    settings.map.initial_blocks = 16;
    settings.map.device_budget_mib = 0.25;
    settings.map.swapping = itm_slam::Swapping::Off;
    let run = run(&device, Box::new(InMemory::new(sequence)), &settings, Poses::Given);
    assert_eq!(run.summary.posed, 6);
    assert!(run.reports().any(|r| !r.notices.is_empty()), "a full pool must be said");
}

#[test]
fn frames_without_depth_begin_no_map_and_poses_that_are_not_finite_are_not_fused() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 6);
    for poses in [Poses::Tracked, Poses::Given] {
        let mut slam = Slam::new(&device, &sequence.calibration(), &small(), poses).expect("a map");
        for (i, mut frame) in sequence.frames().enumerate() {
            if i < 2 {
                frame.depth = DepthImage::Metres(Image::filled(160, 120, f32::NAN));
            }
            if i == 3 {
                let pose = frame.world_from_camera.as_mut().expect("a pose");
                pose.translation.x = f64::NAN;
            }
            // A caller's numbers may be anything.
            frame.index = 7;
            let result = slam.process(&frame).expect("a result");
            match (i, poses) {
                (0 | 1, _) => assert_eq!(result.status, FrameStatus::NoDepth),
                (3, Poses::Given) => assert_eq!(result.status, FrameStatus::NoPose),
                (2, _) | (_, Poses::Given) => assert_eq!(result.status, FrameStatus::Placed),
                (_, Poses::Tracked) => assert_eq!(result.status, FrameStatus::Tracked),
            }
            assert_eq!(result.fused, !matches!(result.status, FrameStatus::NoDepth | FrameStatus::NoPose));
        }
        let mesh = slam.mesh(&mut |_, _| ()).expect("a mesh");
        assert!(mesh.positions.iter().all(|p| p.is_finite()) && !mesh.is_empty());
    }
}

#[test]
fn views_that_no_map_can_hold_are_refused() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 1);
    let mut settings = small();
    settings.map.voxel_size_m = 0.001;
    settings.map.truncation_m = 0.004;
    settings.view.max_depth_m = 500.0;
    let error = Slam::new(&device, &sequence.calibration(), &settings, Poses::Given).unwrap_err().to_string();
    assert!(error.contains("view.max_depth_m") && error.contains("map.voxel_size_m"), "{error}");

    let mut slam = Slam::new(&device, &sequence.calibration(), &small(), Poses::Given).expect("a map");
    let mut frame = sequence.frame(0);
    frame.world_from_camera.as_mut().expect("a pose").translation.x = 6e5;
    let error = slam.process(&frame).unwrap_err().to_string();
    assert!(error.contains("relative to a point of the scene"), "{error}");
}

#[test]
fn a_covered_lens_is_lost_and_tracking_comes_back() {
    let Some(device) = device() else { return };
    // Slow enough for 160x120 pixels; dark from 40 to 70 %.
    let mut spec = Spec::new(Path::Covered).with_size(160, 120);
    spec.frames = 40;
    spec.frame_rate_hz = 10.0;
    let sequence = Sequence::new(spec).expect("a valid specification");
    let run = run(&device, Box::new(InMemory::new(sequence)), &small(), Poses::Tracked);
    let lost: Vec<u64> =
        run.frames.iter().filter(|f| matches!(f.status, FrameStatus::Lost { .. })).map(|f| f.index).collect();
    assert!(lost.contains(&20), "a covered lens cannot be tracked: lost {lost:?}");
    assert!(run.frames[..12].iter().all(|f| f.world_from_camera.is_some()));
    assert!(run.frames.iter().filter(|f| matches!(f.status, FrameStatus::Lost { .. })).all(|f| !f.fused));
    assert_eq!(run.summary.lost, lost.len());
    assert_eq!(run.summary.posed + run.summary.lost, 40);
}

#[test]
fn any_size_works() {
    let Some(device) = device() else { return };
    for size in [(1, 1), (7, 3), (641, 479), (1280, 1024)] {
        let sequence = sequence(Path::Arc, size, 2);
        let mut run = run(&device, Box::new(InMemory::new(sequence)), &small(), Poses::Tracked);
        assert_eq!(run.frames.len(), 2, "{size:?}");
        assert!(run.summary.error.is_none(), "{size:?}: {:?}", run.summary.error);
        run.session.mesh(&mut |_, _| ()).expect("a mesh, be it empty");
    }
}
