//! Pictures for windows: they show what pictures for files show, and looking changes nothing.

use std::collections::BTreeMap;

use itm_slam::{
    Canvas, ColourImage, Device, FrameStatus, Intrinsics, Look, Mode, Poses, Se3, Session, SessionOptions, Shading,
    Slam, Start,
};
use itm_synth::{Path, Sequence, Spec};
use itm_tests::{InMemory, device, sequence, small_map};

fn start(device: &Device, sequence: &Sequence, mode: Mode) -> Slam {
    Slam::new(device, &sequence.calibration(), &small_map(mode), Poses::Tracked).expect("a small map fits")
}

fn look(shading: Shading) -> Look {
    Look {
        camera: Intrinsics::new(150, 110, 120.0, 120.0, 74.5, 54.5),
        world_from_camera: Se3::exp([0.2, -0.1, -0.5, 0.1, -0.2, 0.05]),
        max_depth_m: 5.0,
        shading,
        submap: None,
    }
}

/// Of the pixels that both show, the share that differ by more than a little.
fn difference(a: &ColourImage, b: &ColourImage) -> f64 {
    let both = || a.data().iter().zip(b.data()).filter(|(a, b)| a[3] == b[3]);
    let differs = |(a, b): &(&[u8; 4], &[u8; 4])| (0..3).any(|i| a[i].abs_diff(b[i]) > 8);
    both().filter(differs).count() as f64 / both().count() as f64
}

fn painted(canvas: &Canvas, device: &Device) -> ColourImage {
    canvas.read(device).expect("a picture")
}

fn covered(picture: &ColourImage) -> f64 {
    picture.data().iter().filter(|pixel| pixel[3] == 255).count() as f64 / picture.data().len() as f64
}

#[test]
fn a_window_shows_what_a_picture_shows_and_looking_changes_no_frame() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 12);
    for mode in [Mode::Basic, Mode::Surfels] {
        let (mut slam, mut unseen) = (start(&device, &sequence, mode), start(&device, &sequence, mode));
        let (free, model) = (Canvas::new(&device, (150, 110)).unwrap(), Canvas::new(&device, (160, 120)).unwrap());
        assert!(!slam.paint_model(Shading::Grey, &model).unwrap());
        assert!(covered(&painted(&model, &device)) == 0.0);
        for frame in sequence.frames() {
            slam.process(&frame).expect("a result");
            slam.paint(&look(Shading::Colour), &free).expect("a picture");
            assert!(slam.paint_model(Shading::Colour, &model).unwrap());
            unseen.process(&frame).expect("a result");
        }
        assert!(slam.trajectory() == unseen.trajectory(), "{mode:?}");
        for shading in [Shading::Phong, Shading::Normals, Shading::Colour, Shading::Depth, Shading::Confidence] {
            let wanted = look(shading);
            let picture = slam.render(&wanted.camera, &wanted.world_from_camera, wanted.max_depth_m, shading).unwrap();
            slam.paint(&wanted, &free).expect("a picture");
            let shares = [covered(&picture), difference(&painted(&free, &device), &picture)];
            assert!(painted(&free, &device) == picture && shares[0] > 0.4, "{mode:?} {shading:?}: {shares:?}");
            assert!(slam.paints_whole(None));
            slam.paint_whole(&wanted, &free).expect("a picture");
            assert!(painted(&free, &device) == picture);
        }
        // Where the last frame was, the model is what a picture from there shows.
        let pose = slam.trajectory().poses().last().unwrap().world_from_camera;
        let camera = slam.calibration().depth;
        let from_there = slam.render(&camera, &pose, slam.settings().view.max_depth_m, Shading::Normals).unwrap();
        slam.paint_model(Shading::Normals, &model).unwrap();
        let differ = difference(&painted(&model, &device), &from_there);
        // Of surfels, tracking takes those that are not stable too, and prefers others.
        let bound = if mode == Mode::Basic { 0.05 } else { 0.25 };
        assert!(differ < bound, "{mode:?}: {differ}");
    }
}

#[test]
fn of_submaps_a_window_shows_what_is_nearest_one_alone_or_all_as_one() {
    let Some(device) = device() else { return };
    let spec = Spec::new(Path::Loop).with_size(160, 120).with_frames(90);
    let sequence = Sequence::new(Spec { duration_s: 4.0, ..spec }).expect("a valid specification");
    let mut slam = start(&device, &sequence, Mode::LoopClosure);
    for frame in sequence.frames() {
        slam.process(&frame).expect("a result");
    }
    assert!(slam.submaps().len() > 1);
    let canvas = Canvas::new(&device, (150, 110)).unwrap();
    // From the middle of the room, towards what the last frames saw.
    let wanted =
        Look { world_from_camera: slam.trajectory().poses().last().unwrap().world_from_camera, ..look(Shading::Depth) };
    let as_one = slam.render(&wanted.camera, &wanted.world_from_camera, wanted.max_depth_m, wanted.shading).unwrap();
    assert!(!slam.paints_whole(None) && slam.paints_whole(Some(0)));
    slam.paint_whole(&wanted, &canvas).unwrap();
    assert!(painted(&canvas, &device) == as_one);
    slam.paint(&wanted, &canvas).unwrap();
    let nearest = painted(&canvas, &device);
    let differ = difference(&nearest, &as_one);
    let shares = [covered(&nearest), covered(&as_one), differ];
    // As one, a surface is where all voxels around were seen by one submap; what overlaps is nearer by what does not fit.
    assert!(shares[0] >= shares[1] && shares[0] > 0.7 && differ < 0.05, "{shares:?}");
    let alone: Vec<f64> = (0..slam.submaps().len() as u16)
        .map(|submap| {
            slam.paint(&Look { submap: Some(submap), ..wanted }, &canvas).unwrap();
            covered(&painted(&canvas, &device))
        })
        .collect();
    assert!(alone.iter().all(|share| *share < covered(&nearest) + 1e-9), "{alone:?}");
    assert!(alone.iter().any(|share| *share < 0.5 * covered(&nearest)), "{alone:?}");
}

#[test]
fn a_paced_device_gives_the_same_poses() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 8);
    let run = |paced: bool| {
        device.set_paced(paced);
        let mut slam = start(&device, &sequence, Mode::Basic);
        let results: Vec<_> = sequence.frames().map(|frame| slam.process(&frame).expect("a result")).collect();
        let reports = results.iter().filter_map(|r| r.report.as_ref());
        let timed: BTreeMap<&'static str, f64> =
            reports.flat_map(|r| r.stage_ms.iter().copied()).filter(|(_, ms)| *ms > 0.0).collect();
        (slam.trajectory().clone(), timed)
    };
    let (free, paced) = (run(false), run(true));
    device.set_paced(false);
    assert!(free.0 == paced.0);
    // The same stages are timed, and the rays are not the quickest of them.
    assert!(free.1.keys().all(|stage| paced.1.contains_key(stage)), "{:?}, {:?}", free.1, paced.1);
    assert!(paced.1.values().any(|ms| *ms < paced.1["raycast"]), "{:?}", paced.1);
}

#[test]
fn a_session_goes_on_with_another_frame() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 30);
    let options = SessionOptions {
        settings: small_map(Mode::Basic),
        poses: Poses::Tracked,
        frames: Some(0..25),
        start: Start::Afresh,
    };
    let mut session = Session::new(&device, Box::new(InMemory::new(sequence)), &options).expect("a session");
    let frames = |session: &mut Session| -> Vec<(u64, bool)> {
        session
            .filter_map(|event| match event {
                itm_slam::Event::Frame { result, .. } => {
                    Some((result.index, matches!(result.status, FrameStatus::Tracked | FrameStatus::Placed)))
                }
                _ => None,
            })
            .collect()
    };
    assert_eq!(frames(&mut session).len(), 25);
    assert_eq!(session.place(), (0..25, 25));
    assert_eq!(session.frame().map(|frame| frame.index), Some(24));
    // Back, where it has ended: the map stays, and the camera is found a little away from where it was.
    session.seek(19).expect("a frame of the run");
    let again = frames(&mut session);
    assert!(again.iter().map(|(index, _)| *index).eq(19..25), "{again:?}");
    assert!(again.iter().filter(|(_, good)| *good).count() >= 4, "{again:?}");
    let error = session.seek(25).unwrap_err().to_string();
    assert!(error.contains("25"), "{error}");
}
