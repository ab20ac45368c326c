//! `itm run --save`, `--resume`, `--map` and `--fusion`, with real processes.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use tempfile::TempDir;

/// A command in a folder.
fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_itm"));
    command.args(arguments).current_dir(folder);
    command
}

fn itm(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).output().unwrap()
}

#[track_caller]
fn succeeds(folder: &Path, arguments: &[&str]) {
    let output = itm(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[track_caller]
fn refused(folder: &Path, arguments: &[&str], status: i32, words: &[&str]) {
    let output = itm(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(status), "{said}");
    words.iter().for_each(|word| assert!(said.contains(word), "'{word}' is not in: {said}"));
}

/// A folder with a small recording, `room`; `None` where there is no device to run on.
fn with_recording() -> Option<TempDir> {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    succeeds(folder.path(), &["synth", "room", "--size", "160x120", "--frames", "16", "--quiet"]);
    Some(folder)
}

/// A run of the recording without a mesh.
fn run<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["run", "room", "--no-mesh", "--quiet"], more].concat()
}

/// Arguments for each kind of map. Submaps begin so soon that the few frames here come to several.
const MODES: [&[&str]; 2] = [&["--mode", "basic"], &["--mode", "loop-closure", "--set", "submaps.new_below=0.9"]];

/// Submaps that a saved map has.
fn submaps(folder: &Path, map: &str) -> usize {
    let output = itm(folder, &["info", map, "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    info["submaps"].as_array().unwrap().len()
}

#[test]
fn a_run_goes_on_to_the_same_bytes() {
    let Some(folder) = with_recording() else { return };
    let folder = folder.path();
    for (mode, several) in MODES.into_iter().zip([false, true]) {
        let run_in = |more: &[&str]| succeeds(folder, &run(&[more, mode].concat()));
        run_in(&["-o", "whole", "--save", "whole.itm"]);
        run_in(&["-o", "first", "--frames", "0..9", "--save", "half.itm"]);
        succeeds(folder, &run(&["-o", "second", "--resume", "half.itm", "--save", "second.itm"]));
        let read = |name: &str| fs::read(folder.join(name)).unwrap();
        assert!(read("second/trajectory.txt") == read("whole/trajectory.txt"));
        assert!(read("second.itm") == read("whole.itm"));
        assert_eq!(submaps(folder, "whole.itm") > 1, several, "{mode:?}: {}", submaps(folder, "whole.itm"));
    }

    let bad = |more: &[&str], status, words: &[&str]| refused(folder, &run(more), status, words);
    bad(&["--resume", "whole.itm"], 1, &["after the last frame", "16"]);
    bad(&["--resume", "half.itm", "--set", "map.colour=false"], 2, &["--resume"]);
    bad(&["--resume", "room/calibration.txt"], 1, &["calibration.txt"]);
    bad(&["--map", "none.itm"], 1, &["none.itm"]);
    bad(&["--map", "whole.itm", "--start-pose", "1,2,3"], 2, &["seven numbers"]);
    bad(&["--map", "whole.itm", "--set", "map.voxel_size_m=0.01"], 1, &["voxel_size_m", "0.005", "0.01"]);
    bad(&["--map", "whole.itm", "--mode", "basic"], 1, &["submaps: 2", "mode = \"basic\""]);
    bad(&["--fusion", "off"], 1, &["no map to start in"]);
    fs::create_dir(folder.join("folder.itm")).unwrap();
    bad(&["--save", "folder.itm"], 1, &["folder.itm"]);
}

#[test]
fn a_camera_is_found_in_a_map_that_stays_as_it_is() {
    let Some(folder) = with_recording() else { return };
    let folder = folder.path();
    for (mode, several) in MODES.into_iter().zip([false, true]) {
        succeeds(folder, &run(&[&["--save", "room.itm"], mode].concat()));
        assert_eq!(submaps(folder, "room.itm") > 1, several);
        succeeds(
            folder,
            &run(&["-o", "found", "--map", "room.itm", "--fusion", "off", "--json", "--save", "after.itm"]),
        );
        assert_eq!(submaps(folder, "room.itm"), submaps(folder, "after.itm"));
        let text = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        let positions = |text: &str| -> Vec<f64> {
            let rows = text.lines().filter(|line| !line.starts_with('#'));
            let numbers = |row: &str| row.split(' ').skip(1).take(3).map(|n| n.parse().unwrap()).collect::<Vec<f64>>();
            rows.flat_map(numbers).collect()
        };
        let (before, found) = (positions(&text("out/room/trajectory.txt")), positions(&text("found/trajectory.txt")));
        assert_eq!(before.len(), found.len());
        assert!(before.iter().zip(&found).all(|(a, b)| (a - b).abs() < 0.01), "{before:?}\n{found:?}");
    }
}

/// A program that is killed while it writes leaves the file that was there.
#[test]
#[cfg(unix)]
fn the_earlier_file_survives_a_program_that_is_killed_while_saving() {
    let Some(folder) = with_recording() else { return };
    let folder = folder.path();
    succeeds(folder, &run(&["--frames", "0..3", "--save", "room.itm"]));
    let before = fs::read(folder.join("room.itm")).unwrap();
    let mut killed = 0;
    for _ in 0..10 {
        let mut program = command(folder, &run(&["-o", "again", "--save", "room.itm"]));
        let mut program = program.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let part = folder.join(format!(".room.itm.{}.part", program.id()));
        // As soon as it has written something.
        let writing = || fs::metadata(&part).is_ok_and(|file| file.len() > 0);
        while !writing() && program.try_wait().unwrap().is_none() {}
        program.kill().unwrap();
        program.wait().unwrap();
        if part.exists() {
            killed += 1;
            assert!(fs::read(folder.join("room.itm")).unwrap() == before);
            break;
        }
        // It was faster: its file is the earlier one from here on.
        fs::write(folder.join("room.itm"), &before).unwrap();
    }
    assert_eq!(killed, 1, "it was never killed while it wrote");
    succeeds(folder, &["info", "room.itm"]);
}
