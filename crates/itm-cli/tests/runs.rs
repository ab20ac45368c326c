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
