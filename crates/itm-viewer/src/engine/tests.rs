//! The engine with a reconstruction in it, as the window drives it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use itm_slam::{Device, Event, Mode, Se3, Session, Settings, Shading};
use itm_synth::{Sequence, Spec};

use super::state::{Kind, Scene, State, Verdict};
use super::{CaptureKind, Command, Engine, Open, Wish};
use crate::camera::OrbitCamera;
use crate::keeper::{Keeper, KeeperFor};

fn device() -> Option<Device> {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        return None;
    }
    Some(Device::open("auto").expect("an adapter, or ITM_SKIP_GPU_TESTS set"))
}

fn settings() -> Settings {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = 0.02;
    settings.map.truncation_m = 0.08;
    settings.map.initial_blocks = 256;
    settings
}

fn recording(folder: &Path, frames: u32) -> Open {
    let sequence = Sequence::new(Spec::new(itm_synth::Path::Arc).with_size(160, 120).with_frames(frames)).unwrap();
    itm_synth::write_recording(&folder.join("room"), &sequence, &|_| ()).unwrap();
    Open { run: false, ..Open::new(folder.join("room"), &settings()) }
}

/// Waits until something holds of the state, and returns it.
fn wait(engine: &Engine, what: &str, holds: impl Fn(&State) -> bool) -> State {
    let started = Instant::now();
    loop {
        let state = engine.state().clone();
        if holds(&state) {
            return state;
        }
        let messages: Vec<_> = state.messages.iter().map(|message| message.text.clone()).collect();
        assert!(started.elapsed() < Duration::from_secs(60), "{what}: {messages:?}, {:?}", state.scene);
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn next_of(state: &State) -> Option<usize> {
    match &state.scene {
        Scene::Recording { next, .. } => Some(*next),
        _ => None,
    }
}

fn is_finished(state: &State) -> bool {
    matches!(state.scene, Scene::Recording { finished: true, .. })
}

fn said(state: &State, kind: Kind, text: &str) -> bool {
    state.messages.iter().any(|message| message.kind == kind && message.text.contains(text))
}

#[test]
fn a_recording_goes_frame_by_frame_to_its_end_and_on_from_elsewhere() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let engine = Engine::start(&device, None, |_| ());
    engine.send(Command::Open(Box::new(recording(folder.path(), 16))));
    let opened = wait(&engine, "opened", |state| state.scene.has_frames());
    assert!(!opened.running && opened.rows.is_empty() && opened.frame.is_none());

    engine.send(Command::Step);
    let stepped = wait(&engine, "a frame", |state| next_of(state) == Some(1));
    assert!(stepped.depth.is_some() && stepped.colour.is_some() && !stepped.running);
    assert_eq!(stepped.frame.as_ref().map(|frame| (frame.index, frame.verdict)), Some((0, Verdict::Good)));

    engine.send(Command::Fuse(false));
    wait(&engine, "fusion off", |state| !state.fusing);
    engine.send(Command::Fuse(true));
    engine.send(Command::Run(true));
    let finished = wait(&engine, "the end", is_finished);
    assert_eq!((finished.rows.len(), finished.trajectory.len()), (16, 16));
    assert!(finished.rows.iter().filter(|row| row.size.is_some()).count() >= 12);
    assert!(!finished.running && finished.bounds.is_some() && !finished.keyframes.is_empty());
    assert!(said(&finished, Kind::Done, "16 of 16 have a pose"));

    engine.send(Command::Preview(5));
    engine.send(Command::Seek(12));
    wait(&engine, "frame 12", |state| next_of(state) == Some(12) && !is_finished(state));
    engine.send(Command::Run(true));
    let again = wait(&engine, "the end again", is_finished);
    assert_eq!(again.rows.len(), 20);
    // Each frame counts once, however often it was processed.
    assert_eq!(again.messages.iter().filter(|message| message.text.contains("16 of 16 have a pose")).count(), 2);

    // Started again, with other settings.
    engine.send(Command::Restart(Box::new(Settings { mode: Mode::Surfels, ..settings() })));
    let fresh = wait(&engine, "another start", |state| state.settings.mode == Mode::Surfels);
    assert!(fresh.rows.is_empty() && next_of(&fresh) == Some(0));
}

#[test]
fn views_are_painted_as_wished_and_points_picked() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let engine = Engine::start(&device, None, |_| ());
    engine.send(Command::Open(Box::new(Open { run: true, ..recording(folder.path(), 6) })));
    let followed = wait(&engine, "the end", |state| is_finished(state) && state.shown.is_some() && state.is_finest);
    let shown = followed.shown.unwrap();
    assert!(shown.follows && shown.canvas.size() == (160, 120));
    let covered = |shown: &super::state::Shown| {
        let picture = shown.canvas.read(&device).unwrap();
        picture.data().iter().filter(|pixel| pixel[3] == 255).count() as f64 / picture.data().len() as f64
    };
    assert!(covered(&shown) > 0.5);

    let pose = followed.frame.unwrap().world_from_camera.unwrap();
    let camera = OrbitCamera::at(&pose, 1.5);
    let lens = OrbitCamera::intrinsics((200, 150));
    let wish = Wish { free: Some((lens, camera.world_from_camera())), shading: Shading::Normals, ..Wish::default() };
    engine.wish(Wish { moving: true, ..wish });
    let moving = wait(&engine, "a free view", |state| state.shown.as_ref().is_some_and(|shown| !shown.follows));
    let software = device.capabilities().software;
    assert_eq!(moving.shown.unwrap().canvas.size(), if software { (100, 75) } else { (200, 150) });
    engine.wish(wish);
    let resting = wait(&engine, "a fine view", |state| {
        state.is_finest && state.shown.as_ref().is_some_and(|shown| shown.canvas.size() == (200, 150))
    });
    let shown = resting.shown.unwrap();
    assert!(covered(&shown) > 0.4);

    engine.send(Command::Pick(Box::new(shown.clone()), (100, 75)));
    let (picks, point) = wait(&engine, "a point", |state| state.picked.0 == 1).picked;
    let seen = shown.world_from_camera.inverse().transform_point(point.expect("a wall is there"));
    assert!(picks == 1 && seen.z > 0.5 && seen.z < 8.0 && seen.x.abs() < 0.02 * seen.z, "{seen}");
    engine.send(Command::Pick(Box::new(shown), (5000, 0)));
    assert_eq!(wait(&engine, "no point", |state| state.picked.0 == 2).picked.1, None);
}

#[test]
fn maps_are_saved_meshed_looked_at_and_tracked_in() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let engine = Engine::start(&device, None, |_| ());
    engine.send(Command::Save(at("early.itm")));
    wait(&engine, "nothing to save", |state| said(state, Kind::Error, "no map to save"));
    engine.send(Command::Open(Box::new(Open { run: true, ..recording(folder.path(), 6) })));
    wait(&engine, "the end", is_finished);
    engine.send(Command::Save(at("room.itm")));
    engine.send(Command::Mesh(at("room.nonsense")));
    engine.send(Command::Mesh(at("room.ply")));
    let done = wait(&engine, "a mesh", |state| said(state, Kind::Done, "room.ply"));
    assert!(said(&done, Kind::Done, "room.itm") && said(&done, Kind::Error, "nonsense"));
    assert!(at("room.itm").is_file() && at("room.ply").is_file());

    // In it, the first frame is looked for by keyframes.
    engine.send(Command::TrackIn(at("room.itm")));
    let tracked = wait(&engine, "the end in the map", |state| is_finished(state) && state.rows.len() == 6);
    assert!(tracked.trajectory.len() >= 3, "{} poses", tracked.trajectory.len());

    // Its session has no frame left to go on with; one that was saved earlier has.
    engine.send(Command::GoOn(at("room.itm")));
    wait(&engine, "no frames left", |state| {
        state.messages.iter().any(|m| m.kind == Kind::Error && m.text.contains("frames"))
    });
    engine.send(Command::Open(Box::new(Open { run: false, ..recording(folder.path(), 6) })));
    wait(&engine, "afresh", |state| next_of(state) == Some(0) && state.rows.is_empty());
    for frame in 1..=3 {
        engine.send(Command::Step);
        wait(&engine, "a frame", |state| next_of(state) == Some(frame));
    }
    engine.send(Command::Save(at("early.itm")));
    wait(&engine, "saved", |state| said(state, Kind::Done, "early.itm"));
    engine.send(Command::GoOn(at("early.itm")));
    let on = wait(&engine, "the end of the rest", |state| is_finished(state) && state.rows.len() == 3);
    assert_eq!(on.trajectory.len(), 6);

    engine.send(Command::Open(Box::new(Open::new(at("room.itm"), &settings()))));
    let map = wait(&engine, "the map", |state| matches!(state.scene, Scene::Map { .. }) && state.shown.is_some());
    assert_eq!(map.trajectory.len(), 6);
    assert!(map.shown.unwrap().world_from_camera != Se3::IDENTITY);

    // What cannot be opened leaves open what is.
    std::fs::write(at("broken.itm"), "no map").unwrap();
    for (path, reason) in
        [(at("broken.itm"), "broken.itm"), (at("nothing"), "does not exist"), (at("room.ply"), "neither")]
    {
        engine.send(Command::Open(Box::new(Open::new(path, &settings()))));
        let refused = wait(&engine, reason, |state| said(state, Kind::Error, reason));
        assert!(matches!(refused.scene, Scene::Map { .. }));
    }
}

#[test]
fn what_is_shown_is_recorded_as_pictures_and_as_a_video() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let engine = Engine::start(&device, None, |_| ());
    engine.send(Command::Open(Box::new(recording(folder.path(), 6))));
    wait(&engine, "opened", |state| state.scene.has_frames());
    for (kind, path) in [(CaptureKind::Frames, at("frames")), (CaptureKind::Video, at("video.avi"))] {
        engine.send(Command::Capture(Some((kind, path.clone()))));
        wait(&engine, "recording", |state| state.recording.is_some());
        for _ in 0..3 {
            let before = next_of(&engine.state()).unwrap();
            engine.send(Command::Step);
            wait(&engine, "a frame", |state| next_of(state) == Some(before + 1) && state.is_finest);
        }
        engine.send(Command::Capture(None));
        wait(&engine, "the recording's end", |state| said(state, Kind::Done, &path.display().to_string()));
    }
    let frames = std::fs::read_dir(at("frames")).unwrap().count();
    assert!(frames >= 3, "{frames}");
    assert_eq!(image::open(at("frames/000001.png")).unwrap().to_rgb8().dimensions(), (160, 120));

    assert!(check_video(&at("video.avi")) >= 3);

    // What there is already is not written over, and other endings are none of a video.
    for (kind, path, reason) in
        [(CaptureKind::Frames, at("frames"), "empty folder"), (CaptureKind::Video, at("video.mp4"), ".avi")]
    {
        engine.send(Command::Capture(Some((kind, path))));
        wait(&engine, reason, |state| said(state, Kind::Error, reason));
    }
    // A window that is closed ends it, so that it is whole.
    engine.send(Command::Capture(Some((CaptureKind::Video, at("closed.avi")))));
    wait(&engine, "recording", |state| state.recording.as_ref().is_some_and(|(_, pictures)| *pictures > 0));
    drop(engine);
    assert!(check_video(&at("closed.avi")) >= 1);
}

/// Checks that a file is what its headers say, a list of pictures, each of them a JPEG of that size; how many there are.
fn check_video(path: &Path) -> usize {
    let video = std::fs::read(path).unwrap();
    let word = |at: usize| u32::from_le_bytes(video[at..at + 4].try_into().unwrap());
    assert_eq!((&video[..4], &video[8..16]), (&b"RIFF"[..], &b"AVI LIST"[..]));
    assert_eq!(word(4) as usize, video.len() - 8);
    let list = 12 + 8 + word(16) as usize;
    assert_eq!((&video[list..list + 4], &video[list + 8..list + 12]), (&b"LIST"[..], &b"movi"[..]));
    let index = list + 8 + word(list + 4) as usize;
    assert_eq!(&video[index..index + 4], b"idx1");
    let pictures = word(index + 4) as usize / 16;
    assert_eq!(word(48) as usize, pictures);
    for picture in 0..pictures {
        let entry = index + 8 + 16 * picture;
        let (at, bytes) = (list + 8 + word(entry + 8) as usize, word(entry + 12) as usize);
        assert_eq!((&video[at..at + 4], word(at + 4) as usize), (&b"00dc"[..], bytes));
        let jpeg = image::load_from_memory(&video[at + 8..at + 8 + bytes]).unwrap();
        assert_eq!((jpeg.width(), jpeg.height()), (word(64), word(68)));
    }
    pictures
}

/// What a keeper was told.
#[derive(Debug, Default)]
struct Kept {
    /// Frames, then how often an end came and results were written.
    frames: Vec<u64>,
    ends: usize,
    written: usize,
}

struct Told(Arc<Mutex<Vec<Kept>>>);

impl Keeper for Told {
    fn event(&mut self, event: &Event, _session: &mut Session) -> Result<(), String> {
        let mut all = self.0.lock().unwrap();
        let kept = all.last_mut().unwrap();
        match event {
            Event::Frame { result, .. } => kept.frames.push(result.index),
            Event::Finished(_) => kept.ends += 1,
            _ => {}
        }
        Ok(())
    }

    fn finish(&mut self, session: &mut Session) -> Result<PathBuf, String> {
        let mut all = self.0.lock().unwrap();
        let kept = all.last_mut().unwrap();
        kept.written += 1;
        assert_eq!(kept.written, kept.ends);
        assert_eq!(session.slam().trajectory().len(), kept.frames.len());
        Ok("there".into())
    }
}

#[test]
fn results_are_kept_from_the_first_frame_to_where_the_window_is_closed() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let all: Arc<Mutex<Vec<Kept>>> = Arc::default();
    let keepers = Arc::clone(&all);
    let keeper_for: KeeperFor = Box::new(move |_, session| {
        assert!(session.slam().trajectory().is_empty());
        keepers.lock().unwrap().push(Kept::default());
        Ok(Box::new(Told(Arc::clone(&keepers))))
    });
    let mut engine = Engine::start(&device, Some(keeper_for), |_| ());
    let open = recording(folder.path(), 8);
    engine.send(Command::Open(Box::new(open.clone())));
    wait(&engine, "opened", |state| state.scene.has_frames());
    engine.send(Command::Open(Box::new(open.clone())));
    wait(&engine, "opened again", |state| state.opened.0 == 2);
    assert!(all.lock().unwrap().is_empty(), "nothing was reconstructed");

    // To its end, and once more from a frame before it.
    engine.send(Command::Run(true));
    wait(&engine, "the end", is_finished);
    engine.send(Command::Seek(6));
    wait(&engine, "frame 6", |state| next_of(state) == Some(6));
    engine.send(Command::Run(true));
    wait(&engine, "the end again", is_finished);
    {
        let all = all.lock().unwrap();
        assert_eq!(all[0].frames, [0, 1, 2, 3, 4, 5, 6, 7, 6, 7]);
        assert_eq!((all.len(), all[0].ends, all[0].written), (1, 2, 2));
    }

    // Another one, of which the window is closed in the middle.
    engine.send(Command::Open(Box::new(open)));
    wait(&engine, "opened", |state| state.opened.0 == 3);
    for frame in 1..=3 {
        engine.send(Command::Step);
        wait(&engine, "a frame", |state| next_of(state) == Some(frame));
    }
    let started = Instant::now();
    while !engine.begin_end() {
        assert!(started.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(5));
    }
    let all = all.lock().unwrap();
    assert_eq!(all[1].frames, [0, 1, 2]);
    assert_eq!((all.len(), all[1].ends, all[1].written), (2, 1, 1));
}

#[test]
fn settings_are_taken_over_while_it_runs_as_far_as_they_can_be() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let engine = Engine::start(&device, None, |_| ());
    engine.send(Command::Open(Box::new(recording(folder.path(), 6))));
    wait(&engine, "opened", |state| state.scene.has_frames());
    engine.send(Command::Step);
    let mut wanted = settings();
    wanted.map.max_weight = 33;
    wanted.map.voxel_size_m = 0.01;
    engine.send(Command::Settings(Box::new(wanted)));
    let taken = wait(&engine, "another weight", |state| state.settings.map.max_weight == 33);
    assert_eq!(taken.settings.map.voxel_size_m, 0.02);
    engine.send(Command::Run(true));
    wait(&engine, "the end", is_finished);

    // Started anew something is fused, and settings that cannot be used leave open what is.
    let mut wanted = settings();
    wanted.map.fuse = false;
    engine.send(Command::Restart(Box::new(wanted.clone())));
    let fresh = wait(&engine, "a new start", |state| state.opened.0 == 2);
    assert!(fresh.fusing && fresh.rows.is_empty());
    wanted.map.voxel_size_m = -1.0;
    engine.send(Command::Restart(Box::new(wanted)));
    let refused = wait(&engine, "refused", |state| said(state, Kind::Error, "voxel_size_m"));
    assert_eq!((refused.opened.0, refused.asked.map.voxel_size_m), (2, 0.02));
}

#[test]
fn the_results_of_a_run_are_looked_at() {
    let Some(device) = device() else { return };
    let folder = tempfile::tempdir().unwrap();
    let engine = Engine::start(&device, None, |_| ());
    engine.send(Command::Open(Box::new(Open { run: true, ..recording(folder.path(), 6) })));
    wait(&engine, "the end", is_finished);
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    engine.send(Command::Mesh(out.join("mesh.ply")));
    wait(&engine, "a mesh", |state| said(state, Kind::Done, "mesh.ply"));
    std::fs::write(out.join("settings.toml"), settings().to_toml()).unwrap();
    std::fs::write(out.join("trajectory.txt"), "0 0 0 0 0 0 0 1\n0.1 0.1 0 0 0 0 0 1\n").unwrap();
    std::fs::write(out.join("timings.csv"), "frame,status,view,total_ms\n0,placed,1,20\n").unwrap();

    engine.wish(Wish { shading: Shading::Colour, ..Wish::default() });
    engine.send(Command::Open(Box::new(Open::new(&out, &settings()))));
    let shows =
        |state: &State| matches!(state.scene, Scene::Results { .. }) && state.shown.is_some() && state.is_finest;
    let results = wait(&engine, "the results", shows);
    assert_eq!((results.trajectory.len(), results.rows.len()), (2, 1));
    assert_eq!(results.settings.map.voxel_size_m, 0.02);
    let picture = results.shown.unwrap().canvas.read(&device).unwrap();
    let colours: Vec<_> = picture.data().iter().filter(|pixel| pixel[3] == 255).collect();
    assert!(colours.len() > picture.data().len() / 4);
    // In colour, and not all grey.
    assert!(colours.iter().any(|[r, g, b, _]| r.abs_diff(*g).max(g.abs_diff(*b)) > 30));
    let (min, max) = results.bounds.unwrap();
    assert!((max - min).min_element() > 0.3);
    // There is nothing to save.
    engine.send(Command::Save(folder.path().join("no.itm")));
    wait(&engine, "nothing to save", |state| said(state, Kind::Error, "no map to save"));
}
