//! The window's panels and keys, without a reconstruction behind them.

use std::sync::Arc;
use std::sync::mpsc::Receiver;

use egui::Key;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;
use itm_io::recording::OpenOptions;
use itm_slam::{Canvas, Device, Intrinsics, Se3, Settings, SubmapState};

use crate::app::{Overlays, Viewer};
use crate::dialog::{Dialog, Purpose};
use crate::engine::state::{FrameSummary, Kind, Row, Scene, Shown, State, SubmapSummary, Verdict};
use crate::engine::{CaptureKind, Command, Engine};
use crate::textures::Textures;
use crate::theme;

/// A window and the commands that it sends.
fn window(change: impl FnOnce(&mut State)) -> (Harness<'static, Viewer>, Receiver<Command>) {
    let (engine, commands) = Engine::without_thread(|_| ());
    change(&mut engine.state());
    let viewer = Viewer::new(engine, Textures::default(), Settings::default(), OpenOptions::default());
    let harness =
        Harness::builder().with_size([1280.0, 800.0]).build_ui_state(|ui, viewer: &mut Viewer| viewer.ui(ui), viewer);
    (harness, commands)
}

/// A recording of 100 frames, of which 40 are done.
fn recording(state: &mut State) {
    state.scene = Scene::Recording {
        name: "room".into(),
        about: "tum, 100 frames".into(),
        depth_camera: Intrinsics::new(160, 120, 130.0, 130.0, 79.5, 59.5),
        frames: 0..100,
        next: 40,
        finished: false,
    };
    state.fusing = true;
    state.frame = Some(FrameSummary {
        index: 39,
        verdict: Verdict::Poor,
        reasons: vec!["few inliers: 21 %".into()],
        world_from_camera: Some(Se3::IDENTITY),
    });
    state.rows = (0..40)
        .map(|frame| Row {
            frame,
            total_ms: Some(50.0),
            stages_ms: vec![("view".into(), 2.0), ("track".into(), 20.0)],
            size: Some(2000),
            map_mib: Some(16.0),
            residual_mm: Some(1.5),
            verdict: Some(Verdict::Good),
        })
        .collect();
}

/// The commands sent so far, but for wishes for views.
fn sent(commands: &Receiver<Command>) -> Vec<Command> {
    commands.try_iter().filter(|command| !matches!(command, Command::Look)).collect()
}

fn press(harness: &mut Harness<'static, Viewer>, key: Key) {
    harness.key_press(key);
    harness.run_steps(2);
}

#[test]
fn an_empty_window_says_what_to_do() {
    let (mut harness, commands) = window(|_| ());
    harness.run_steps(2);
    harness.get_by_label_contains("Drop a recording here");
    harness.get_by_label_contains("itm synth room");
    assert!(sent(&commands).is_empty());
    // What needs a recording cannot be done.
    press(&mut harness, Key::Space);
    press(&mut harness, Key::K);
    assert!(sent(&commands).is_empty() && harness.state().dialog.is_none());
}

#[test]
fn keys_send_their_commands() {
    let (mut harness, commands) = window(recording);
    harness.run_steps(2);
    press(&mut harness, Key::Space);
    assert!(matches!(sent(&commands)[..], [Command::Run(true)]));
    press(&mut harness, Key::N);
    assert!(matches!(sent(&commands)[..], [Command::Step]));
    press(&mut harness, Key::B);
    assert!(matches!(sent(&commands)[..], [Command::Run(true)]));
    press(&mut harness, Key::T);
    assert!(matches!(sent(&commands)[..], [Command::Fuse(false)]));
    press(&mut harness, Key::R);
    assert!(matches!(sent(&commands)[..], [Command::Restart(_)]));
    let before = harness.state().view.colouring;
    press(&mut harness, Key::C);
    assert_eq!(harness.state().view.colouring, before + 1);
    press(&mut harness, Key::F);
    assert!(harness.state().view.free);
    press(&mut harness, Key::I);
    assert!(!harness.state().show_sidebar);
}

#[test]
fn a_running_reconstruction_is_paused() {
    let (mut harness, commands) = window(|state| {
        recording(state);
        state.running = true;
    });
    harness.run_steps(2);
    harness.get_by_label("⏸ Pause").click();
    harness.run_steps(2);
    assert!(matches!(sent(&commands)[..], [Command::Run(false)]));
}

#[test]
fn the_verdict_is_said_with_its_reasons() {
    let (mut harness, _commands) = window(recording);
    harness.run_steps(3);
    harness.get_by_label("tracking poor");
    harness.get_by_label("few inliers: 21 %");
    harness.get_by_label("40 / 99");
    harness.get_by_label_contains("20.0 frames/s");
}

#[test]
fn files_are_asked_for_and_sent() {
    let (mut harness, commands) = window(recording);
    harness.run_steps(2);
    press(&mut harness, Key::K);
    harness.run_steps(2);
    harness.get_by_label("Save the map");
    // Keys belong to the dialog now.
    press(&mut harness, Key::N);
    assert!(sent(&commands).is_empty());
    harness.get_by_label("Save").click();
    harness.run_steps(2);
    assert!(matches!(&sent(&commands)[..], [Command::Save(path)] if path.starts_with("room.itm")));
    press(&mut harness, Key::W);
    harness.run_steps(2);
    harness.get_by_label("Write").click();
    harness.run_steps(2);
    assert!(matches!(&sent(&commands)[..], [Command::Mesh(path)] if path.as_os_str() == "room.ply"));
    // A map may be meant to be tracked in.
    press(&mut harness, Key::L);
    harness.run_steps(2);
    harness.get_by_role(egui::accesskit::Role::TextInput).type_text("other.itm");
    harness.run_steps(2);
    harness.get_by_label("Track this recording in it").click();
    harness.run_steps(2);
    assert!(matches!(&sent(&commands)[..], [Command::TrackIn(path)] if path.as_os_str() == "other.itm"));
    press(&mut harness, Key::K);
    harness.run_steps(2);
    press(&mut harness, Key::Escape);
    harness.run_steps(2);
    assert!(harness.state().dialog.is_none() && sent(&commands).is_empty());
}

#[test]
fn a_file_that_is_there_is_replaced_by_the_button_that_says_so_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("there.itm");
    std::fs::write(&path, "something").unwrap();
    let (mut harness, commands) = window(recording);
    harness.run_steps(2);
    harness.state_mut().dialog = Some(Dialog::new(Purpose::Save, path.display().to_string()));
    harness.run_steps(3);
    press(&mut harness, Key::Enter);
    assert!(sent(&commands).is_empty() && harness.state().dialog.is_some());
    harness.get_by_label_contains("There is a file of that name");
    harness.get_by_label("Replace").click();
    harness.run_steps(2);
    assert!(matches!(&sent(&commands)[..], [Command::Save(saved)] if *saved == path));
}

/// Lets a picture of the map be there, from a pose two metres behind the world's origin.
fn show_a_picture(state: &mut State) -> bool {
    if std::env::var_os("ITM_SKIP_GPU_TESTS").is_some() {
        return false;
    }
    let device = Device::open("auto").expect("an adapter, or ITM_SKIP_GPU_TESTS set");
    let behind = Se3 { translation: glam::DVec3::new(0.0, 0.0, -2.0), ..Se3::IDENTITY };
    state.shown = Some(Shown {
        canvas: Arc::new(Canvas::new(&device, (800, 600)).unwrap()),
        camera: Intrinsics::new(800, 600, 600.0, 600.0, 399.5, 299.5),
        world_from_camera: behind,
        follows: false,
    });
    true
}

#[test]
fn recording_the_pane_begins_with_a_name_and_ends_with_the_key() {
    let (mut harness, commands) = window(recording);
    harness.run_steps(2);
    // Nothing is shown yet, so nothing can be recorded.
    press(&mut harness, Key::V);
    assert!(harness.state().dialog.is_none());
    if !show_a_picture(&mut harness.state().engine.state()) {
        return;
    }
    for (key, title, expected) in [
        (Key::V, "Record a video", (CaptureKind::Video, "room.avi")),
        (Key::S, "Record pictures into a folder", (CaptureKind::Frames, "room-frames")),
    ] {
        press(&mut harness, key);
        harness.run_steps(2);
        harness.get_by_label(title);
        // The dialog's, above the menu of that name.
        harness.get_all_by_label("Record").last().unwrap().click();
        harness.run_steps(2);
        let sent = sent(&commands);
        assert!(
            matches!(&sent[..], [Command::Capture(Some((kind, path)))] if (*kind, path.to_str().unwrap()) == expected),
            "{sent:?}"
        );
    }
    // The same key ends it.
    harness.state().engine.state().recording = Some(("room.avi".into(), 12));
    press(&mut harness, Key::V);
    assert!(matches!(sent(&commands)[..], [Command::Capture(None)]) && harness.state().dialog.is_none());
}

/// Of the lines that a window draws those of a colour.
fn lines_of(harness: &Harness<'static, Viewer>, colour: egui::Color32) -> usize {
    fn count(shape: &egui::Shape, colour: egui::Color32) -> usize {
        match shape {
            egui::Shape::Vec(shapes) => shapes.iter().map(|shape| count(shape, colour)).sum(),
            egui::Shape::LineSegment { stroke, .. } => usize::from(stroke.color == colour),
            egui::Shape::Path(path) => usize::from(path.stroke.color == egui::epaint::ColorMode::Solid(colour)),
            egui::Shape::Circle(circle) => usize::from(circle.fill == colour),
            _ => 0,
        }
    }
    harness.output().shapes.iter().map(|clipped| count(&clipped.shape, colour)).sum()
}

#[test]
fn the_way_the_camera_submaps_and_links_are_drawn_over_the_map() {
    let (mut harness, commands) = window(|state| {
        recording(state);
        state.trajectory = Arc::new((0..10).map(|i| glam::DVec3::X * (0.1 * f64::from(i))).collect());
        let submap = |x: f64, state| SubmapSummary {
            world_from_submap: Se3 { translation: glam::DVec3::X * x, ..Se3::IDENTITY },
            state,
        };
        state.submaps = vec![submap(0.0, SubmapState::Passive), submap(0.5, SubmapState::Primary)];
        state.links = vec![(0, 1, true)];
        state.keyframes = Arc::new(vec![Se3::IDENTITY]);
    });
    if !show_a_picture(&mut harness.state().engine.state()) {
        return;
    }
    press(&mut harness, Key::F);
    // The pane sees what the picture does.
    harness.run_steps(2);
    let verdict = theme::verdict(Verdict::Poor);
    let keyframe = theme::KEYFRAME.gamma_multiply(0.8);
    let drawn = |harness: &Harness<'static, Viewer>| {
        [theme::ACCENT, theme::CLOSURE, theme::submap(SubmapState::Primary), verdict, keyframe]
            .map(|colour| lines_of(harness, colour))
    };
    let all = drawn(&harness);
    assert!(all.iter().all(|count| *count > 0), "{all:?}");
    harness.state_mut().view.overlay = Overlays { trajectory: false, camera: true, keyframes: false, submaps: false };
    harness.run_steps(2);
    let some = drawn(&harness);
    // Plots and legends have colours of these too.
    assert!([0, 1, 2, 4].iter().all(|i| some[*i] < all[*i]), "{some:?} of {all:?}");
    assert_eq!(some[3], all[3]);

    // The point under a double click is asked for, of the picture that was clicked.
    let before = sent(&commands).len();
    assert_eq!(before, 0);
    let middle = egui::Pos2::new(500.0, 400.0);
    // However long a frame of the test takes.
    harness.ctx.options_mut(|options| options.input_options.max_double_click_delay = 60.0);
    for _ in 0..2 {
        harness.drag_at(middle);
        harness.drop_at(middle);
    }
    harness.run_steps(2);
    let sent = sent(&commands);
    assert!(
        matches!(&sent[..], [Command::Pick(shown, (x, y))] if shown.canvas.size() == (800, 600) && *x < 800 && *y < 600),
        "{sent:?}"
    );
}

#[test]
fn escape_leaves_a_text_or_a_menu_before_it_closes_the_window() {
    let (mut harness, _commands) = window(recording);
    press(&mut harness, Key::Comma);
    harness.run_steps(2);
    harness.get_by_label("Search").click();
    harness.run_steps(2);
    press(&mut harness, Key::Escape);
    assert!(!harness.state().quits);
    harness.run_steps(2);
    harness.get_by_label("Overlays").click();
    harness.run_steps(2);
    harness.get_by_label("Trajectory");
    press(&mut harness, Key::Escape);
    assert!(!harness.state().quits);
    harness.run_steps(2);
    assert!(harness.query_by_label("Trajectory").is_none());
    // The menu's button may have the keyboard still.
    press(&mut harness, Key::Escape);
    press(&mut harness, Key::Escape);
    assert!(harness.state().quits);
}

/// A file as the system drops it.
#[derive(Debug)]
struct Dropped(std::path::PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &std::path::Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        Err("only its path is asked for".into())
    }
}

#[test]
fn what_is_dropped_is_opened_and_what_was_opened_is_recent() {
    let (mut harness, commands) = window(|_| ());
    harness.run_steps(2);
    harness.input_mut().dropped_files = vec![Arc::new(Dropped("/recordings/room".into()))];
    harness.step();
    let sent = sent(&commands);
    assert!(matches!(&sent[..], [Command::Open(open)] if open.path.ends_with("room")), "{sent:?}");
    // It is one of the recent ones once it could be opened.
    assert!(harness.state().recent.is_empty());
    {
        let mut state = harness.state().engine.state();
        recording(&mut state);
        state.opened = (1, "room".into());
    }
    harness.run_steps(2);
    assert_eq!(harness.state().recent, [std::path::absolute("room").unwrap()]);
    press(&mut harness, Key::O);
    harness.run_steps(2);
    harness.get_by_label(&std::path::absolute("room").unwrap().display().to_string()).click();
    harness.run_steps(2);
    assert!(matches!(&self::sent(&commands)[..], [Command::Open(open)] if open.path.is_absolute()));
}

#[test]
fn the_form_follows_what_is_open_and_the_key_for_fusion() {
    let (mut harness, commands) = window(recording);
    harness.run_steps(2);
    press(&mut harness, Key::T);
    assert!(matches!(sent(&commands)[..], [Command::Fuse(false)]));
    // What is changed in the form next does not switch it on again.
    assert!(!harness.state().settings.map.fuse);
    {
        let mut state = harness.state().engine.state();
        state.opened.0 += 1;
        state.asked.map.max_weight = 77;
        state.submaps.clear();
    }
    harness.state_mut().view.submap = Some(5);
    harness.run_steps(2);
    assert_eq!(harness.state().settings.map.max_weight, 77);
    assert_eq!(harness.state().view.submap, None);
}

#[test]
fn submaps_are_shown_one_by_one_or_all() {
    let (mut harness, _commands) = window(|state| {
        recording(state);
        let submap = SubmapSummary { world_from_submap: Se3::IDENTITY, state: SubmapState::Passive };
        state.submaps = vec![submap; 3];
    });
    harness.run_steps(2);
    harness.get_by_label("All submaps");
    let mut shown = Vec::new();
    for _ in 0..4 {
        press(&mut harness, Key::CloseBracket);
        shown.push(harness.state().view.submap);
    }
    assert_eq!(shown, [Some(0), Some(1), Some(2), None]);
    press(&mut harness, Key::OpenBracket);
    assert_eq!(harness.state().view.submap, Some(2));
    harness.run_steps(2);
    harness.get_by_label("Submap 2");
}

#[test]
fn the_scrub_bar_previews_and_then_goes_on_from_there() {
    let (mut harness, commands) = window(recording);
    harness.run_steps(2);
    let slider = harness.get_by_role(egui::accesskit::Role::Slider).rect();
    harness.drag_at(slider.lerp_inside(egui::Vec2::new(0.4, 0.5)));
    harness.run_steps(1);
    harness.hover_at(slider.lerp_inside(egui::Vec2::new(0.8, 0.5)));
    harness.run_steps(2);
    let previewed = sent(&commands);
    assert!(matches!(previewed.last(), Some(Command::Preview(frame)) if (70..90).contains(frame)), "{previewed:?}");
    harness.drop_at(slider.lerp_inside(egui::Vec2::new(0.8, 0.5)));
    harness.run_steps(2);
    assert!(matches!(sent(&commands)[..], [Command::Seek(frame)] if (70..90).contains(&frame)));
}

#[test]
fn errors_stay_until_they_are_taken_away_and_all_is_in_the_list() {
    let (mut harness, _commands) = window(recording);
    harness.run_steps(2);
    {
        let mut state = harness.state().engine.state();
        state.say(Some(7), Kind::Error, "the map is not saved: no room");
        state.say(None, Kind::Event, "submap 3 begins");
    }
    harness.run_steps(3);
    // In the list and over the pane.
    assert_eq!(harness.get_all_by_label("the map is not saved: no room").count(), 2);
    harness.get_by_label("submap 3 begins");
    harness.get_by_label("×").click();
    harness.run_steps(2);
    assert_eq!(harness.get_all_by_label("the map is not saved: no room").count(), 1);
}

#[test]
fn the_sheet_shows_all_keys() {
    let (mut harness, _commands) = window(|_| ());
    press(&mut harness, Key::F1);
    harness.run_steps(3);
    harness.get_by_label("Keys");
    for about in crate::action::ACTIONS {
        assert!(harness.query_all_by_label(about.does).next().is_some(), "{}", about.does);
    }
    press(&mut harness, Key::Escape);
    harness.run_steps(3);
    assert!(harness.query_by_label("Keys").is_none());
}

#[test]
fn dragging_turns_the_free_view_and_the_wheel_comes_nearer() {
    let (mut harness, _commands) = window(recording);
    press(&mut harness, Key::F);
    let before = harness.state().view.camera;
    let middle = egui::Pos2::new(500.0, 400.0);
    harness.drag_at(middle);
    harness.run_steps(1);
    harness.hover_at(middle + egui::Vec2::new(80.0, 0.0));
    harness.run_steps(1);
    assert!(harness.state().view.moving);
    harness.drop_at(middle + egui::Vec2::new(80.0, 0.0));
    harness.run_steps(1);
    let turned = harness.state().view.camera;
    harness.hover_at(middle);
    harness.run_steps(2);
    assert!(turned.yaw > before.yaw && turned.pivot == before.pivot && turned.distance_m == before.distance_m);
    harness.event(egui::Event::MouseWheel {
        unit: egui::MouseWheelUnit::Line,
        delta: egui::Vec2::new(0.0, 3.0),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Wheel,
        modifiers: egui::Modifiers::NONE,
    });
    harness.run_steps(6);
    assert!(harness.state().view.camera.distance_m < turned.distance_m);
}

#[test]
fn all_of_it_fits_a_small_window_at_twice_the_scale_light_and_dark() {
    for theme in [egui::Theme::Light, egui::Theme::Dark] {
        let (engine, _commands) = Engine::without_thread(|_| ());
        recording(&mut engine.state());
        let viewer = Viewer::new(engine, Textures::default(), Settings::default(), OpenOptions::default());
        let mut harness = Harness::builder()
            .with_size([720.0, 480.0])
            .with_pixels_per_point(2.0)
            .with_theme(theme)
            .build_ui_state(|ui, viewer: &mut Viewer| viewer.ui(ui), viewer);
        harness.run_steps(3);
        let pane = harness.state().view.pane_pixels;
        assert!(pane.0 >= 400 && pane.1 >= 400, "{pane:?}");
    }
}
