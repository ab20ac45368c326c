//! The window, in a virtual display: `itm view` opens, reconstructs and keeps its results.
#![cfg(target_os = "linux")]

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use itm_synth::{Sequence, Spec};

/// A virtual display, which ends with the test.
struct Display {
    server: Child,
    number: String,
}

impl Display {
    fn start() -> Self {
        // It looks for a number that is free, and says which.
        let server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1600x1000x24", "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb starts; `cargo xtask setup` installs it");
        let mut display = Self { server, number: String::new() };
        let mut said = BufReader::new(display.server.stdout.take().expect("it is piped"));
        said.read_line(&mut display.number).expect("a number");
        display.number = display.number.trim().to_owned();
        assert!(!display.number.is_empty(), "Xvfb ended at once");
        display
    }

    fn itm(&self, folder: &Path, arguments: &[&str]) -> Output {
        let mut itm = Command::new(env!("CARGO_BIN_EXE_itm"));
        itm.args(arguments).current_dir(folder).env("HOME", folder).env("XDG_DATA_HOME", folder);
        itm.env("DISPLAY", format!(":{}", self.number)).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
        itm.output().expect("the program starts")
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _gone = self.server.kill();
        let _ended = self.server.wait();
    }
}

fn picture(path: &Path) -> image::RgbImage {
    image::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).to_rgb8()
}

/// Different colours in a picture, in steps of 16.
fn colours(picture: &image::RgbImage) -> usize {
    picture.pixels().map(|pixel| pixel.0.map(|value| value / 16)).collect::<std::collections::HashSet<_>>().len()
}

#[test]
fn a_recording_is_reconstructed_in_the_window_and_its_map_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let sequence = Sequence::new(Spec::new(itm_synth::Path::Arc).with_size(160, 120).with_frames(12)).unwrap();
    itm_synth::write_recording(&at("room"), &sequence, &|_| ()).unwrap();
    let display = Display::start();

    let output = display.itm(folder.path(), &["view", "room", "--picture", "window.png", "--size", "1000x700"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    let window = picture(&at("window.png"));
    assert_eq!(window.dimensions(), (1000, 700));
    // Of panels and text alone there are far fewer.
    assert!(colours(&window) > 60, "{} colours", colours(&window));
    // What a run without a window leaves.
    for name in ["trajectory.txt", "mesh.ply", "settings.toml", "timings.csv", "report.html"] {
        assert!(at("out/room-view").join(name).is_file(), "{name}; {told}");
    }
    assert!(told.contains("frames with a pose: 12 of 12"), "{told}");

    let saved = Command::new(env!("CARGO_BIN_EXE_itm"))
        .args(["run", "room", "--save", "room.itm", "--quiet"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(saved.status.success());
    // The same bytes as without a window.
    for name in ["trajectory.txt", "mesh.ply"] {
        let read = |out: &str| std::fs::read(at(out).join(name)).unwrap();
        assert!(read("out/room") == read("out/room-view"), "{name}");
    }

    let output = display.itm(folder.path(), &["view", "room.itm", "--picture", "map.png", "--size", "800x600"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(colours(&picture(&at("map.png"))) > 40);
}

#[test]
fn what_cannot_be_opened_is_said_in_the_window_and_without_a_display_by_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let display = Display::start();
    let output = display.itm(folder.path(), &["view", "nothing-here", "--picture", "window.png"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(folder.path().join("window.png").is_file());

    let mut itm = Command::new(env!("CARGO_BIN_EXE_itm"));
    let output = itm.args(["view"]).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(told.contains("no window can be opened"), "{told}");
}
