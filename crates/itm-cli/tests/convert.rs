//! `itm convert`, and runs over what it writes. Runs need a graphics adapter, be it a software one.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "this is a test, and its helpers outside of #[test] functions are too"
)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

/// A folder with a recording, with a sensor's noise and colour taken after depth, in `room`.
fn with_recording(frames: u32) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut spec = itm_synth::Spec::new(itm_synth::Path::Arc).with_size(160, 120).with_frames(frames);
    spec.noise = Some(itm_synth::DepthNoise::KINECT);
    spec.inertial_noise = Some(itm_synth::InertialNoise::PHONE);
    spec.colour_delay_s = 0.01;
    let sequence = itm_synth::Sequence::new(spec).unwrap();
    itm_synth::write_recording(&folder.path().join("room"), &sequence, &|_| ()).unwrap();
    folder
}

fn itm(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_itm")).args(arguments).current_dir(folder).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[track_caller]
fn succeed(output: Output) -> Output {
    assert!(output.status.success(), "{}", stderr(&output));
    output
}

#[test]
fn a_run_over_the_converted_recording_makes_the_same_bytes() {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        println!("skipped: ITM_SKIP_GPU_TESTS is set");
        return;
    }
    let folder = with_recording(12);
    let converted = succeed(itm(folder.path(), &["convert", "room", "room.mcap", "--json"]));
    let summary: serde_json::Value = serde_json::from_slice(&converted.stdout).unwrap();
    assert_eq!((&summary["frames"], &summary["skipped"]), (&12.into(), &0.into()));
    let run = |recording: &str, out: &str, more: &[&str]| {
        let coarse = ["--set", "map.voxel_size_m=0.02", "--set", "map.truncation_m=0.08", "--quiet"];
        succeed(itm(folder.path(), &[&["run", recording, "-o", out][..], &coarse, more].concat()));
    };
    run("room", "a", &[]);
    run("room.mcap", "b", &[]);
    // Poses of the recording, and its gyroscope, are there too.
    run("room", "c", &["--poses", "given", "--no-mesh"]);
    run("room.mcap", "d", &["--poses", "given", "--no-mesh"]);
    run("room", "e", &["--tracker", "type=imuicp", "--no-mesh"]);
    run("room.mcap", "f", &["--tracker", "type=imuicp", "--no-mesh"]);
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    for (a, b) in [("a", "b"), ("c", "d"), ("e", "f")] {
        let [a, b] = [a, b].map(|out| read(&format!("{out}/trajectory.txt")));
        assert!(a == b, "two trajectories differ");
        assert_eq!(String::from_utf8(a).unwrap().lines().filter(|line| !line.starts_with('#')).count(), 12);
    }
    assert!(read("a/mesh.ply") == read("b/mesh.ply"), "two meshes differ");
    let evaluate = |truth: &str| succeed(itm(folder.path(), &["eval", "a/trajectory.txt", truth, "--json"])).stdout;
    assert_eq!(evaluate("room"), evaluate("room.mcap"));
}

#[test]
fn what_cannot_be_converted_is_said() {
    let folder = with_recording(2);
    let refused = |arguments: &[&str]| {
        let output = itm(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        stderr(&output)
    };
    assert!(refused(&["convert", "room", "room.bag"]).contains("expected a name that ends in .mcap"));
    assert!(refused(&["convert", "nowhere", "room.mcap"]).contains("'nowhere' does not exist"));
    let topics = refused(&["convert", "room", "room.mcap", "--topics", "depth=/depth"]);
    assert!(topics.contains("topics are of recordings in the format mcap; this one is tum"), "{topics}");
    assert!(!folder.path().join("room.mcap").exists());

    succeed(itm(folder.path(), &["convert", "room", "room.mcap"]));
    assert!(refused(&["convert", "room.mcap", "room.mcap"]).contains("is the recording itself"));
    let wrong = itm(folder.path(), &["convert", "room.mcap", "b.mcap", "--topics", "deep=/a"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("expected NAME=TOPIC"), "{}", stderr(&wrong));

    // A frame that cannot be read is left out, and said to be.
    let list = fs::read_to_string(folder.path().join("room/depth.txt")).unwrap();
    let first =
        list.lines().find(|line| !line.starts_with('#')).and_then(|line| line.split_whitespace().nth(1)).unwrap();
    fs::write(folder.path().join("room").join(first), b"no image").unwrap();
    let output = succeed(itm(folder.path(), &["convert", "room", "room.mcap"]));
    assert!(stderr(&output).contains("skipped: frame 0: "), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("1 frames, 1 could not be read"));
}
