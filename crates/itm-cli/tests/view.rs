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
        self.command(folder, arguments).output().expect("the program starts")
    }

    fn command(&self, folder: &Path, arguments: &[&str]) -> Command {
        let mut itm = Command::new(env!("CARGO_BIN_EXE_itm"));
        itm.args(arguments).current_dir(folder).env("HOME", folder).env("XDG_DATA_HOME", folder);
        itm.env("DISPLAY", format!(":{}", self.number)).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
        itm
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _gone = self.server.kill();
        let _ended = self.server.wait();
    }
}

/// Whether windows cannot be tested here.
fn skips() -> bool {
    std::env::var_os("ITM_SKIP_GPU_TESTS").is_some()
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
    if skips() {
        return;
    }
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
fn a_window_that_is_interrupted_writes_its_results_first() {
    if skips() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out/room-view");
    let spec = Spec::new(itm_synth::Path::Loop).with_size(160, 120).with_frames(150);
    itm_synth::write_recording(&folder.path().join("room"), &Sequence::new(spec).unwrap(), &|_| ()).unwrap();
    let display = Display::start();
    // One that only waits leaves the results of an earlier run alone.
    std::fs::create_dir_all(&out).unwrap();
    std::fs::write(out.join("report.html"), "earlier").unwrap();
    let mut waiting =
        display.command(folder.path(), &["view", "room", "--paused", "--size", "700x500"]).spawn().unwrap();
    std::thread::sleep(std::time::Duration::from_secs(2));
    interrupt(&mut waiting);
    assert_eq!(std::fs::read_to_string(out.join("report.html")).unwrap(), "earlier");

    let mut window = display.command(folder.path(), &["view", "room", "--size", "700x500"]).spawn().unwrap();
    let poses = || std::fs::read_to_string(out.join("trajectory.txt")).unwrap_or_default().lines().count();
    let started = std::time::Instant::now();
    while poses() < 8 {
        assert!(started.elapsed().as_secs() < 60, "{} poses", poses());
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    interrupt(&mut window);
    assert!(poses() >= 8 && poses() < 150, "{} poses", poses());
    for name in ["mesh.ply", "timings.csv"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("<html"));
}

/// As Ctrl-C does, and waits for the program's end.
fn interrupt(program: &mut Child) {
    let asked = Command::new("kill").args(["-INT", &program.id().to_string()]).status().expect("kill starts");
    assert!(asked.success());
    let started = std::time::Instant::now();
    loop {
        if let Some(status) = program.try_wait().expect("it can be waited for") {
            return assert!(status.success(), "{status}");
        }
        assert!(started.elapsed().as_secs() < 60, "it does not end");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

#[test]
fn what_cannot_be_opened_is_said_in_the_window_and_without_a_display_by_the_program() {
    if skips() {
        return;
    }
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
