//! Whole runs on real recordings, where the environment variable `ITM_TEST_DATA` names a folder of them.

#![allow(clippy::print_stdout, reason = "the figures are what these tests are for")]

use itm_io::recording::{OpenOptions, open};
use itm_slam::evaluation::{DEFAULT_TOLERANCE_NS, evaluate};
use itm_slam::{Poses, Settings};
use itm_tests::{device, real_recording, run};

/// Tracks a recording by depth; no frame may be lost, and the ATE over all frames at most this.
fn track(name: &str, frames: usize, limit_m: f64) {
    let Some(path) = real_recording(name) else { return };
    let Some(device) = device() else { return };
    let recording = open(&path, &OpenOptions::default()).expect("a recording");
    let truth = recording.info().ground_truth.clone().expect("ground truth");
    let mut run = run(&device, recording, &Settings::default(), Poses::Tracked);
    assert_eq!((run.summary.posed, run.summary.lost, run.summary.skipped), (frames, 0, 0));
    let evaluation =
        evaluate(run.session.slam_mut().trajectory(), &truth, DEFAULT_TOLERANCE_NS).expect("an evaluation");
    println!("{name}: {frames} frames\n{evaluation}");
    assert!(evaluation.ate.rmse <= limit_m, "{name}: ATE {:.1} mm", evaluation.ate.rmse * 1e3);
}

#[test]
fn the_kitchen_is_tracked() {
    track("7scenes_redkitchen_head", 300, 0.036);
}

#[test]
fn the_living_room_is_tracked() {
    track("icl_lr_kt2_head", 160, 0.008);
}
