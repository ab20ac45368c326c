//! Whole runs of the program on small synthetic recordings. They need a graphics adapter, be it a software one.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "this is a test, and its helpers outside of #[test] functions are too"
)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// Settings that suit 160x120 pixels.
const COARSE: [&str; 4] = ["--set", "map.voxel_size_m=0.02", "--set", "map.truncation_m=0.08"];

/// Whether to go without a GPU; says so.
fn skipped() -> bool {
    let skipped = std::env::var_os("ITM_SKIP_GPU_TESTS").is_some();
    if skipped {
        println!("skipped: ITM_SKIP_GPU_TESTS is set");
    }
    skipped
}

/// A folder with a recording of so many frames in `room`.
fn with_recording(frames: u32) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let spec = itm_synth::Spec::new(itm_synth::Path::Arc).with_size(160, 120).with_frames(frames);
    let sequence = itm_synth::Sequence::new(spec).unwrap();
    itm_synth::write_recording(&folder.path().join("room"), &sequence, &|_| ()).unwrap();
    folder
}

fn command(folder: &Path, out: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_itm"));
    command.args(["run", "room", "-o", out, "--json"]).args(COARSE).current_dir(folder);
    command
}

#[track_caller]
fn succeed(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn summary(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

/// What a program that embeds the crate does makes the bytes that this one makes.
#[test]
fn a_loop_over_frames_makes_the_programs_bytes() {
    use itm_slam::{Device, Mode, Poses, Session, Settings, Slam};
    if skipped() {
        return;
    }
    let folder = with_recording(10);
    let device = Device::open("auto").unwrap();
    for mode in [Mode::Basic, Mode::LoopClosure, Mode::Surfels] {
        let (out, map) = (mode.name(), format!("{}.itm", mode.name()));
        succeed(command(folder.path(), out).args(["--no-mesh", "--mode", mode.name(), "--save", &map]));
        let options = itm_io::recording::OpenOptions::default();
        let mut recording = itm_io::recording::open(&folder.path().join("room"), &options).unwrap();
        let info = recording.info().clone();
        let overrides: Vec<String> =
            COARSE.iter().filter(|word| **word != "--set").map(|word| (*word).to_owned()).collect();
        let settings = Settings { mode, ..Settings::resolve(None, &overrides).unwrap() };
        let settings = Session::fit(&settings, &info, Poses::Tracked);
        let mut slam = Slam::new(&device, &info.calibration, &settings, Poses::Tracked).unwrap();
        for index in 0..info.frames {
            slam.process(&recording.read(index).unwrap()).unwrap();
        }
        slam.finish().unwrap();
        let own = folder.path().join("own.itm");
        slam.save(&own).unwrap();
        assert!(fs::read(own).unwrap() == fs::read(folder.path().join(map)).unwrap(), "{out}");
        slam.settle();
        let own = folder.path().join("own.txt");
        let mut writer = itm_io::trajectory::TumWriter::create(&own, itm_io::trajectory::TimeColumn::Seconds).unwrap();
        for (pose, number) in slam.corrected_trajectory().poses().iter().zip(0..) {
            writer.write(number, pose).unwrap();
        }
        drop(writer);
        let written = fs::read(folder.path().join(out).join("trajectory.txt")).unwrap();
        assert!(fs::read(own).unwrap() == written, "{out}");
    }
}

#[test]
fn a_run_leaves_its_results_and_a_second_one_the_same_bytes() {
    if skipped() {
        return;
    }
    let folder = with_recording(10);
    let summary = summary(&succeed(command(folder.path(), "a").args(["--mesh-format", "ply,glb"])));
    succeed(&mut command(folder.path(), "b"));
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert!(read("a/trajectory.txt") == read("b/trajectory.txt"), "two trajectories differ");
    assert!(read("a/mesh.ply") == read("b/mesh.ply"), "two meshes differ");
    assert!(read("a/mesh.ply").len() > 10_000 && read("a/mesh.glb").starts_with(b"glTF"));

    assert_eq!(summary["posed"], 10);
    assert!(summary["evaluation"]["ate"]["rmse"].as_f64().unwrap() < 0.01);
    let text = |name: &str| String::from_utf8(read(name)).unwrap();
    assert_eq!(text("a/trajectory.txt").lines().filter(|l| !l.starts_with('#')).count(), 10);
    let timings = text("a/timings.csv");
    let header: Vec<&str> = timings.lines().next().unwrap().split(',').collect();
    for column in ["frame", "view", "track", "allocate", "integrate", "raycast", "total_ms"] {
        assert!(header.contains(&column), "{header:?}");
    }
    assert_eq!(timings.lines().count(), 11);
    assert!(timings.lines().all(|row| row.split(',').count() == header.len()));
    let report = text("a/report.html");
    assert!(report.contains("<svg") && report.contains("data:image/png;base64,"));
    assert!(!report.contains("src=\"http") && !report.contains("href=\"http"), "the report must stand on its own");
    // What was in force can be given back.
    succeed(command(folder.path(), "c").args(["--settings", "a/settings.toml", "--no-mesh"]));
    assert!(read("a/trajectory.txt") == read("c/trajectory.txt"));
}

#[test]
fn an_unreadable_frame_is_reported_counted_and_skipped() {
    if skipped() {
        return;
    }
    let folder = with_recording(6);
    let depth = folder.path().join("room/depth/000003.png");
    let whole = fs::read(&depth).unwrap();
    fs::write(&depth, &whole[..whole.len() / 2]).unwrap();
    let output = succeed(&mut command(folder.path(), "out"));
    let summary = summary(&output);
    assert_eq!((&summary["posed"], &summary["skipped"], &summary["lost"]), (&5.into(), &1.into(), &0.into()));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("000003.png"), "{said}");
}

/// Puts 'no measurement' in place of a frame's depth.
fn blind(folder: &Path, frame: u32) {
    let depth = image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(160, 120);
    depth.save(folder.join(format!("room/depth/{frame:06}.png"))).unwrap();
}

#[test]
fn a_frame_without_depth_is_lost_and_explained() {
    if skipped() {
        return;
    }
    let folder = with_recording(8);
    blind(folder.path(), 4);
    let output = succeed(command(folder.path(), "out").args(["--explain", "--no-mesh"]));
    let summary = summary(&output);
    assert_eq!(summary["lost"], 1, "{summary}");
    assert_eq!(summary["posed"], 7);
    let not_good = summary["not_good"].as_array().unwrap();
    let lost = not_good.iter().find(|frame| frame["verdict"] == "lost").unwrap();
    assert_eq!(lost["frame"], 4);
    assert!(!lost["reasons"][0].as_str().unwrap().is_empty());
    let poor = not_good.iter().filter(|frame| frame["verdict"] == "poor").count();
    assert_eq!(summary["poor"], poor);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(said.lines().filter(|line| line.starts_with("frame ")).count(), not_good.len(), "{said}");
    assert!(said.contains("frame 4: lost: "), "{said}");
    let read = |name: &str| fs::read_to_string(folder.path().join("out").join(name)).unwrap();
    assert!(!read("trajectory.txt").to_lowercase().contains("nan"));
    assert!(read("timings.csv").contains(",lost,"));
    assert!(read("report.html").contains("Frames that were not good"));
}

#[test]
fn a_recording_without_any_depth_ends_without_a_pose() {
    if skipped() {
        return;
    }
    let folder = with_recording(3);
    (0..3).for_each(|frame| blind(folder.path(), frame));
    let summary = summary(&succeed(command(folder.path(), "out").args(["--explain"])));
    assert_eq!((&summary["posed"], &summary["lost"]), (&0.into(), &0.into()), "{summary}");
    let verdicts: Vec<_> = summary["not_good"].as_array().unwrap().iter().map(|frame| &frame["verdict"]).collect();
    assert_eq!(verdicts, ["no-depth"; 3]);
    assert!(folder.path().join("out/report.html").exists());
}

#[test]
fn a_recording_without_colour_runs_on_depth_alone() {
    if skipped() {
        return;
    }
    let folder = with_recording(5);
    fs::remove_dir_all(folder.path().join("room/rgb")).unwrap();
    ["rgb.txt", "associations.txt"]
        .iter()
        .for_each(|name| fs::remove_file(folder.path().join("room").join(name)).unwrap());
    let plain = summary(&succeed(command(folder.path(), "plain").args(["--no-mesh"])));
    assert_eq!((&plain["posed"], &plain["has_colour"]), (&5.into(), &false.into()));
    let trackers =
        ["type=extended,useDepth=1,useColour=1", "type=composite,policy=refine;type=extended,useDepth=1,useColour=1"];
    for tracker in trackers {
        let sets = ["--no-mesh", "--set", "tracker.extended.use_map_colour=true", "--tracker", tracker];
        let output = succeed(command(folder.path(), "colour").args(sets));
        assert_eq!(summary(&output)["posed"], 5);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(said.matches("compares depth alone").count(), usize::from(tracker == trackers[0]), "{said}");
        let trajectory = |out: &str| fs::read(folder.path().join(out).join("trajectory.txt")).unwrap();
        assert!(trajectory("plain") == trajectory("colour"), "{tracker}: the trajectory is another one");
    }
}

#[test]
fn the_trackers_string_wins_over_the_settings() {
    if skipped() {
        return;
    }
    let folder = with_recording(3);
    let sets = ["--no-mesh", "--set", "tracker.kind=extended", "--set", "tracker.icp.max_steps_fine=9"];
    succeed(command(folder.path(), "out").args(sets).args(["--tracker", "type=icp,levels=bb"]));
    let settings = fs::read_to_string(folder.path().join("out/settings.toml")).unwrap();
    for line in ["kind = \"icp\"", "levels = \"bb\"", "max_steps_fine = 9"] {
        assert!(settings.contains(line), "{line} is not in {settings}");
    }
    let timings = fs::read_to_string(folder.path().join("out/timings.csv")).unwrap();
    let header: Vec<&str> = timings.lines().next().unwrap().split(',').collect();
    let column = header.iter().position(|name| *name == "iterations").unwrap();
    assert_eq!(timings.lines().nth(2).unwrap().split(',').nth(column).unwrap().split('/').count(), 2);
}

#[cfg(unix)]
#[test]
fn ctrl_c_still_leaves_mesh_and_report() {
    if skipped() {
        return;
    }
    let folder = with_recording(120);
    let mut child = command(folder.path(), "out").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let rows = || fs::read_to_string(folder.path().join("out/trajectory.txt")).unwrap_or_default().lines().count();
    let patience = Instant::now() + Duration::from_secs(120);
    while rows() < 4 {
        assert!(Instant::now() < patience, "no frame was written");
        assert!(child.try_wait().unwrap().is_none(), "the run ended before it could be interrupted");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    for name in ["mesh.ply", "report.html", "timings.csv", "settings.toml"] {
        assert!(folder.path().join("out").join(name).exists(), "{name} is missing");
    }
    assert!(rows() < 121, "the run was not cut short");
}
