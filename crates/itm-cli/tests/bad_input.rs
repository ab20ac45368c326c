//! Bad input to the program: each a clear error that names what is wrong, found before a device is opened, so that no
//! graphics adapter is needed here.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

fn itm(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_itm")).args(arguments).current_dir(folder).output().unwrap()
}

/// A folder with a recording of three frames in `room`.
fn with_recording() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let spec = itm_synth::Spec::new(itm_synth::Path::Arc).with_size(32, 24).with_frames(3);
    let sequence = itm_synth::Sequence::new(spec).unwrap();
    itm_synth::write_recording(&folder.path().join("room"), &sequence, &|_| ()).unwrap();
    folder
}

#[track_caller]
fn check_in(folder: &Path, arguments: &[&str], status: i32, words: &[&str]) {
    let output = itm(folder, arguments);
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{error}");
    assert!(output.stdout.is_empty(), "results are printed where there are none");
    assert!(words.iter().all(|word| error.contains(word)), "{words:?} are not all in: {error}");
}

#[test]
fn a_missing_recording_is_named() {
    let folder = tempfile::tempdir().unwrap();
    check_in(folder.path(), &["run", "nowhere"], 1, &["'nowhere' does not exist"]);
    fs::write(folder.path().join("file"), "").unwrap();
    check_in(folder.path(), &["run", "file"], 1, &["'file' is a file"]);
    check_in(folder.path(), &["run", "."], 1, &["no known format", "depth.txt"]);
    // Nothing was left behind.
    assert!(!folder.path().join("out").exists());
}

#[test]
fn settings_that_cannot_be_meant_are_refused_with_their_place() {
    let folder = with_recording();
    let run = |more: &[&str], words: &[&str]| {
        check_in(folder.path(), &[&["run", "room"], more].concat(), 1, words);
    };
    run(&["--set", "map.voxels=1"], &["map.voxels=1", "voxel_size_m"]);
    run(&["--set", "map.voxel_size_m"], &["'map.voxel_size_m' is not of the form key=value"]);
    run(&["--set", "map.voxel_size_m=0.0"], &["map.voxel_size_m must be between"]);
    run(&["--settings", "none.toml"], &["cannot read the settings 'none.toml'"]);
    fs::write(folder.path().join("my.toml"), "[map]\n\nvoxel = 1\n").unwrap();
    run(&["--settings", "my.toml"], &["my.toml", "line 3", "voxel_size_m"]);
}

#[test]
fn ranges_of_frames_are_checked() {
    let folder = with_recording();
    check_in(folder.path(), &["run", "room", "--frames", "5"], 2, &["--frames", "expected A..B"]);
    check_in(folder.path(), &["run", "room", "--frames", "2..2"], 2, &["holds no frame"]);
    check_in(folder.path(), &["run", "room", "--frames", "0..4"], 1, &["--frames 0..4", "frames 0 to 2"]);
    check_in(folder.path(), &["run", "room", "--frames", "3.."], 1, &["--frames 3..", "frames 0 to 2"]);
}

#[test]
fn outputs_that_cannot_be_written_are_refused_at_once() {
    let folder = with_recording();
    fs::write(folder.path().join("taken"), "").unwrap();
    check_in(folder.path(), &["run", "room", "-o", "taken"], 1, &["'taken' is a file"]);
    check_in(folder.path(), &["run", "room", "-o", "taken/deeper"], 1, &["cannot make the output folder"]);
    check_in(folder.path(), &["run", "room", "-o", "room"], 1, &["is the recording itself"]);
    // No file can be made here, not even by root.
    #[cfg(target_os = "linux")]
    check_in(folder.path(), &["run", "room", "-o", "/proc/self"], 1, &["cannot write", "'/proc/self'"]);
    assert!(folder.path().join("room/groundtruth.txt").exists());
}

#[test]
fn calibrations_are_named_with_their_line() {
    let folder = with_recording();
    let bad = folder.path().join("bad.txt");
    fs::write(&bad, "640 480\n525 x\n319.5 239.5\n").unwrap();
    check_in(folder.path(), &["run", "room", "--calibration", "bad.txt"], 1, &["'bad.txt', line 2"]);
    check_in(folder.path(), &["run", "room", "--calibration", "none.txt"], 1, &["'none.txt'"]);
    check_in(folder.path(), &["run", "room", "--format", "rosbag"], 2, &["rosbag", "7-scenes"]);
}

#[test]
fn given_poses_must_be_there() {
    let folder = with_recording();
    fs::remove_file(folder.path().join("room/groundtruth.txt")).unwrap();
    check_in(folder.path(), &["run", "room", "--poses", "given"], 1, &["'room' has no poses"]);
}

/// Takes a recording's colour: what is left is an image folder with a calibration.
fn without_colour(folder: &Path) {
    let room = folder.join("room");
    fs::remove_dir_all(room.join("rgb")).unwrap();
    ["rgb.txt", "associations.txt"].iter().for_each(|name| fs::remove_file(room.join(name)).unwrap());
}

#[test]
fn trackers_that_cannot_be_meant_are_refused_with_those_there_are() {
    let folder = with_recording();
    let run = |tracker: &str, words: &[&str]| {
        check_in(folder.path(), &["run", "room", "--tracker", tracker], 1, words);
    };
    run("type=orb", &["'type=orb'", "there is no tracker 'orb'; there are icp, extended"]);
    run("type=icp,useDepth=1", &["'icp' has no key 'useDepth'; its keys are levels"]);
    run("icp", &["'icp' is not of the form key=value"]);
    check_in(folder.path(), &["run", "room", "--tracker"], 2, &["--tracker"]);
    let help = String::from_utf8(itm(folder.path(), &["run", "--help"]).stdout).unwrap();
    assert!(itm_core::TrackerKind::ALL.iter().all(|kind| help.contains(kind.name())), "{help}");
}

#[test]
fn trackers_by_colour_need_it() {
    let folder = with_recording();
    let run = |more: &[&str], words: &[&str]| {
        check_in(folder.path(), &[&["run", "room"], more].concat(), 1, words);
    };
    let blind = "type=extended,useDepth=0,useColour=1";
    run(&["--tracker", "type=rgb", "--set", "map.colour=false"], &["'rgb' compares colours", "map.colour is off"]);
    run(&["--tracker", "type=rgb", "--set", "view.colour=false"], &["'rgb' compares colours", "view.colour is off"]);
    run(&["--tracker", blind, "--set", "view.colour=false"], &["'extended'", "view.colour is off"]);
    let of_map = ["--tracker", "type=extended,useDepth=0,useColour=0", "--set", "tracker.extended.use_map_colour=true"];
    run(&[&of_map[..], &["--set", "map.colour=false"]].concat(), &["'extended'", "map.colour is off"]);
    without_colour(folder.path());
    run(&["--tracker", "type=rgb"], &["'rgb' compares colours, but the recording 'room' has none"]);
    run(&["--tracker", "type=composite;type=icp;type=rgb"], &["'rgb'", "'room' has none"]);
    run(&["--tracker", blind], &["'extended'", "'room' has none"]);
    assert!(!folder.path().join("out").exists());
}

#[test]
fn trackers_by_an_inertial_sensor_need_one() {
    let folder = with_recording();
    fs::remove_file(folder.path().join("room/gyroscope.txt")).unwrap();
    for (tracker, instead) in [("imuicp", "'icp'"), ("extendedimu", "'extended'")] {
        let given = format!("type={tracker}");
        check_in(folder.path(), &["run", "room", "--tracker", &given], 1, &[tracker, "'room'", "gyroscope", instead]);
    }
}

#[test]
fn trackers_by_files_need_a_pose_of_each_frame() {
    let folder = with_recording();
    let run = |mask: &str, more: &[&str], words: &[&str]| {
        let given = format!("type=file,mask={mask}");
        check_in(folder.path(), &[&["run", "room", "--tracker", &given], more].concat(), 1, words);
    };
    run("", &[], &["tracker.file.mask must be a mask"]);
    run("poses/%06d.txt", &[], &["'poses' does not exist"]);
    run("none.txt", &[], &["'none.txt'"]);
    fs::create_dir(folder.path().join("poses")).unwrap();
    run("poses/%06d.txt", &[], &["'poses' holds no pose files"]);
    let identity = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    for frame in [0, 1] {
        fs::write(folder.path().join(format!("poses/{frame:06}.txt")), identity).unwrap();
    }
    run("poses/%06d.txt", &[], &["'poses/%06d.txt', which has none of frame 2"]);
    run("poses/%06d.txt", &["--frames", "2.."], &["none of frame 2"]);
    // By time: the recording's own truth but for its second frame.
    let truth = fs::read_to_string(folder.path().join("room/groundtruth.txt")).unwrap();
    let times = fs::read_to_string(folder.path().join("room/depth.txt")).unwrap();
    let time =
        times.lines().filter(|line| !line.starts_with('#')).nth(1).unwrap().split(' ').next().unwrap().to_string();
    let second: f64 = time.parse().unwrap();
    let kept = |line: &&str| {
        let time = line.split(' ').next().unwrap().parse::<f64>();
        time.map_or(true, |time| (time - second).abs() > 0.025)
    };
    let lines: Vec<&str> = truth.lines().filter(kept).collect();
    fs::write(folder.path().join("truth.txt"), lines.join("\n") + "\n").unwrap();
    run("truth.txt", &[], &["'truth.txt', which has none of frame 1"]);
}

#[test]
fn trajectories_that_cannot_be_compared() {
    let folder = with_recording();
    let truth = "room/groundtruth.txt";
    fs::write(folder.path().join("est.txt"), "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n").unwrap();
    check_in(folder.path(), &["eval", "est.txt", truth], 1, &["'est.txt', line 2", "found 7 values"]);
    check_in(folder.path(), &["eval", "none.txt", truth], 1, &["'none.txt'"]);
    fs::write(folder.path().join("est.txt"), "# nothing\n").unwrap();
    check_in(folder.path(), &["eval", "est.txt", truth], 1, &["the estimate has no poses"]);
    fs::write(folder.path().join("est.txt"), "900 0 0 0 0 0 0 1\n").unwrap();
    check_in(folder.path(), &["eval", "est.txt", truth], 1, &["no estimated pose lies within 20 ms"]);
}

#[test]
fn a_trajectory_is_measured_against_a_file_and_a_recording() {
    let folder = with_recording();
    let truth = "room/groundtruth.txt";
    let text = String::from_utf8(itm(folder.path(), &["eval", truth, truth]).stdout).unwrap();
    assert!(text.contains("ATE (mm)") && text.contains("3 of 3 estimated poses"), "{text}");
    let json = itm(folder.path(), &["eval", truth, "room", "--json"]).stdout;
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!(json["frames"], 3);
    assert_eq!(json["posed_share"], 1.0);
    assert!(json["ate"]["rmse"].as_f64().unwrap() < 1e-9, "{json}");
}

#[test]
fn synthetic_recordings_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let output = itm(folder.path(), &["synth", "room", "--frames", "2", "--size", "33x21", "--noise", "off"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    for name in ["depth.txt", "groundtruth.txt", "calibration.txt", "surface.ply", "synthetic_scene.txt"] {
        assert!(folder.path().join("room").join(name).is_file(), "{name} is missing");
    }
    check_in(folder.path(), &["synth", "room", "--size", "640"], 2, &["WIDTHxHEIGHT"]);
    check_in(folder.path(), &["synth", "room", "--duration", "0"], 1, &["the duration in seconds"]);
    check_in(folder.path(), &["synth", "room", "--path", "spiral"], 2, &["spiral", "covered"]);
    fs::write(folder.path().join("taken"), "").unwrap();
    check_in(folder.path(), &["synth", "taken", "--frames", "1"], 1, &["cannot write taken"]);
}

/// Frame numbers in an estimate's time column meet a recording that has no times.
#[test]
fn frame_numbers_meet_recordings_without_times() {
    let Some(data) = std::env::var_os("ITM_TEST_DATA").map(std::path::PathBuf::from) else {
        eprintln!("skipped: ITM_TEST_DATA is not set");
        return;
    };
    let recording = data.join("icl_lr_kt2_head");
    let truth = recording.join("livingRoom2.gt.freiburg");
    let folder = tempfile::tempdir().unwrap();
    let output = itm(folder.path(), &["eval", truth.to_str().unwrap(), recording.to_str().unwrap(), "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["pairs"], json["truth_poses"]);
    assert!(json["ate"]["max"].as_f64().unwrap() < 1e-9, "{json}");
}
