//! Sessions beside a camera's own loop, and beside each other.

use itm_slam::{CameraLoop, Device, Frame, Poses, Settings, Slam, WhenLate};
use itm_synth::{Path, Sequence};
use itm_tests::{device, sequence};

fn start(device: &Device, sequence: &Sequence) -> Slam {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    Slam::new(device, &sequence.calibration(), &settings, Poses::Tracked).expect("a small map fits")
}

fn frames(sequence: &Sequence) -> Vec<Frame> {
    sequence.frames().collect()
}

#[test]
fn where_the_camera_waits_every_frame_is_processed_as_without_a_loop() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 15);
    let mut alone = start(&device, &sequence);
    for frame in frames(&sequence) {
        alone.process(&frame).expect("a result");
    }
    // Two at once, on one device.
    let loops = [(); 2].map(|()| CameraLoop::start(start(&device, &sequence), WhenLate::Wait));
    for frame in frames(&sequence) {
        assert!(loops.iter().all(|running| running.push(frame.clone())));
    }
    for running in loops {
        let results: Vec<_> =
            running.results().iter().take(15).map(|result| result.expect("it is processed")).collect();
        assert!(results.iter().map(|result| result.index).eq(0..15));
        assert_eq!(running.dropped(), 0);
        let slam = running.stop();
        assert!(slam.trajectory() == alone.trajectory());
    }
}

#[test]
fn a_camera_that_does_not_wait_loses_frames_and_knows_how_many() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 30);
    let running = CameraLoop::start(start(&device, &sequence), WhenLate::Drop);
    let started = std::time::Instant::now();
    for frame in frames(&sequence) {
        assert!(running.push(frame));
    }
    let pushed = started.elapsed();
    let processed = |result: Result<_, itm_slam::Error>| result.expect("no frame failed");
    let mut results: Vec<itm_slam::FrameResult> = running.results().try_iter().map(processed).collect();
    while results.last().is_none_or(|last| last.index < 29) {
        results.push(processed(running.results().recv().expect("the last frame is processed")));
    }
    assert_eq!(results.len() as u64 + running.dropped(), 30, "pushed in {pushed:?}");
    assert!(running.dropped() > 0 && results.is_sorted_by_key(|result| result.index));
    // How many come between two that are processed is up to the machine, and with them whether the camera is followed: what has
    // been lost is not in the trajectory.
    let posed = results.iter().filter(|result| result.world_from_camera.is_some()).map(|result| result.timestamp);
    assert!(running.stop().trajectory().poses().iter().map(|pose| pose.timestamp).eq(posed));
}

#[test]
fn a_loop_ends_from_another_thread_and_goes_on_after_a_frame_that_does_not_fit() {
    let Some(device) = device() else { return };
    let sequence = sequence(Path::Arc, (160, 120), 3);
    let running = CameraLoop::start(start(&device, &sequence), WhenLate::Wait);
    let stopper = running.stopper();
    std::thread::spawn(move || stopper.stop()).join().expect("it stops");
    assert!(frames(&sequence).into_iter().all(|frame| !running.push(frame)));
    assert!(running.stop().trajectory().is_empty());

    let other = itm_tests::sequence(Path::Arc, (80, 60), 3);
    let running = CameraLoop::start(start(&device, &sequence), WhenLate::Wait);
    assert!(running.push(frames(&sequence).remove(0)));
    assert!(running.push(frames(&other).remove(0)));
    assert!(running.push(frames(&sequence).remove(1)));
    let results: Vec<_> = running.results().iter().take(3).collect();
    assert!(results[0].is_ok() && results[2].is_ok());
    let error = results[1].as_ref().expect_err("an image of another size");
    assert!(error.to_string().contains("80x60"), "{error}");
    assert_eq!(running.stop().trajectory().len(), 2);

    // One that is dropped ends too, and its session with it.
    let running = CameraLoop::start(start(&device, &sequence), WhenLate::Wait);
    let stopper = running.stopper();
    assert!(running.push(frames(&sequence).remove(0)));
    drop(running);
    stopper.stop();
}
