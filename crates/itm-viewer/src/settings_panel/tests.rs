use egui::{Key, OutputCommand};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable as _;
use itm_core::{Mode, Settings};

use super::form::{Entry, Group, NEEDS_RESTART, form};
use super::{RESET, SettingsAction, SettingsPanel};

struct Shown {
    panel: SettingsPanel,
    actions: Vec<SettingsAction>,
}

fn shown(settings: &Settings) -> Harness<'static, Shown> {
    let state = Shown { panel: SettingsPanel::new(settings.clone()), actions: Vec::new() };
    let show = |ui: &mut egui::Ui, shown: &mut Shown| {
        let action = shown.panel.ui(ui);
        shown.actions.extend(action);
    };
    // High enough that nothing is scrolled away.
    Harness::builder().with_size([700.0, 6000.0]).build_ui_state(show, state)
}

fn click(harness: &mut Harness<'_, Shown>, label: &str) {
    harness.get_by_label(label).click();
    harness.run();
}

/// Writes a number, or a text, in place of what there is.
fn write(harness: &mut Harness<'_, Shown>, label: &str, text: &str) {
    harness.get_by_label(label).click();
    harness.run();
    harness.key_press_modifiers(egui::Modifiers::COMMAND, Key::A);
    harness.run();
    harness.event(egui::Event::Text(text.to_owned()));
    harness.run();
    harness.key_press(Key::Enter);
    harness.run();
}

fn search(harness: &mut Harness<'_, Shown>, text: &str) {
    write(harness, "Search", text);
}

/// The settings that were handed out since the last time.
fn changed(harness: &mut Harness<'_, Shown>) -> Option<Settings> {
    match harness.state_mut().actions.drain(..).next_back()? {
        SettingsAction::Changed(settings) => Some(settings),
        SettingsAction::Restart(_) => None,
    }
}

#[test]
fn switches_numbers_texts_and_choices_are_changed() {
    let mut harness = shown(&Settings::default());
    let mut expected = Settings::default();
    click(&mut harness, "map");
    click(&mut harness, "fuse");
    expected.map.fuse = false;
    assert_eq!(changed(&mut harness), Some(expected.clone()));
    write(&mut harness, "voxel_size_m", "0.01");
    expected.map.voxel_size_m = 0.01;
    assert_eq!(changed(&mut harness), Some(expected.clone()));
    write(&mut harness, "max_weight", "70000");
    expected.map.max_weight = u16::MAX;
    assert_eq!(changed(&mut harness), Some(expected.clone()), "the largest there is");
    click(&mut harness, "swapping");
    click(&mut harness, "delete");
    expected.map.swapping = itm_core::Swapping::Delete;
    assert_eq!(changed(&mut harness), Some(expected.clone()));
    click(&mut harness, "dense");
    harness.get_all_by_label("offset").nth(1).expect("three numbers").click();
    harness.run();
    harness.key_press_modifiers(egui::Modifiers::COMMAND, Key::A);
    harness.event(egui::Event::Text("-64".into()));
    harness.key_press(Key::Enter);
    harness.run();
    expected.map.dense.offset[1] = -64;
    assert_eq!(changed(&mut harness), Some(expected.clone()));
    click(&mut harness, "device");
    write(&mut harness, "adapter", "1");
    expected.device.adapter = "1".into();
    assert_eq!(changed(&mut harness), Some(expected));
    harness.run();
    assert_eq!(changed(&mut harness), None, "nothing more was done");
}

#[test]
fn what_cannot_be_used_is_told_and_kept_until_it_is_put_right() {
    let mut harness = shown(&Settings::default());
    click(&mut harness, "map");
    write(&mut harness, "truncation_m", "0.001");
    assert_eq!(changed(&mut harness), None);
    let error = "map.truncation_m must be between map.voxel_size_m and 100, not 0.001";
    assert!(harness.query_by_label(error).is_some());
    assert_eq!(harness.get_by_label("truncation_m").value().as_deref(), Some("0.001"));
    assert_eq!(harness.state().panel.settings(), &Settings::default());
    write(&mut harness, "truncation_m", "0.04");
    let settings = changed(&mut harness).expect("it can be used");
    assert_eq!(settings.map.truncation_m, 0.04);
    assert!(harness.query_by_label(error).is_none());
}

#[test]
fn lists_are_written_as_in_a_settings_file() {
    let mut harness = shown(&Settings::default());
    click(&mut harness, "tracker");
    click(&mut harness, "composite");
    write(&mut harness, "trackers", "[ 'type=rgb' ");
    assert_eq!(changed(&mut harness), None);
    assert!(harness.query_by_label_contains("is no value, as in a settings file").is_some());
    assert_eq!(harness.get_by_label("trackers").value().as_deref(), Some("[ 'type=rgb' "));
    write(&mut harness, "trackers", "['type=rgb']");
    assert_eq!(changed(&mut harness).expect("it can be used").tracker.composite.trackers, ["type=rgb"]);
    assert_eq!(harness.get_by_label("trackers").value().as_deref(), Some(r#"["type=rgb"]"#));
    write(&mut harness, "trackers", "5");
    assert_eq!(changed(&mut harness), None);
    click(&mut harness, "Defaults");
    assert_eq!(changed(&mut harness), Some(Settings::default()));
}

#[test]
fn what_differs_from_the_default_goes_back_to_it() {
    let mut settings = Settings::default();
    settings.map.colour_band = 0.5;
    settings.map.fuse = false;
    let mut harness = shown(&settings);
    click(&mut harness, "map");
    assert!(harness.query_by_label("Reset voxel_size_m").is_none());
    harness.get_by_label("Reset colour_band").hover();
    harness.run();
    assert!(harness.query_by_label("Back to the default: 0.25").is_some());
    click(&mut harness, "Reset colour_band");
    settings.map.colour_band = 0.25;
    assert_eq!(changed(&mut harness), Some(settings));
    assert!(harness.query_by_label("Reset colour_band").is_none());
    click(&mut harness, "Defaults");
    assert_eq!(changed(&mut harness), Some(Settings::default()));
}

#[test]
fn a_search_shows_what_it_finds_and_opens_groups() {
    let mut harness = shown(&Settings::default());
    assert!(harness.query_by_label("close_loops").is_none());
    search(&mut harness, "passive LOOKED");
    assert!(harness.query_by_label("close_loops").is_some(), "by its documentation");
    assert!(harness.query_by_label("central_blocks").is_none() && harness.query_by_label("mode").is_none());
    search(&mut harness, "voxel_size");
    assert!(harness.query_by_label("voxel_size_m").is_some() && harness.query_by_label("map").is_some());
    assert!(harness.query_by_label("close_loops").is_none() && harness.query_by_label("submaps").is_none());
    assert_eq!(harness.query_all_by_label(NEEDS_RESTART).count(), 1, "it has a mark");
    search(&mut harness, "map.fuse");
    assert_eq!(harness.query_all_by_label(NEEDS_RESTART).count(), 0, "it has none");
    search(&mut harness, "voxel_size_m xyzzy");
    assert!(harness.query_by_label_contains("No setting").is_some());
    assert!(harness.state().actions.is_empty());
}

#[test]
fn what_waits_for_a_restart_is_told_with_a_button() {
    let mut harness = shown(&Settings::default());
    click(&mut harness, "mode");
    click(&mut harness, "surfels-loop-closure");
    assert!(changed(&mut harness).is_some());
    assert!(harness.query_by_label("Restart to apply").is_none(), "no session runs");
    harness.state_mut().panel.set_in_force(Some(Settings::default()));
    harness.run();
    assert!(harness.query_by_label_contains("1 setting waits for a restart").is_some());
    click(&mut harness, "map");
    click(&mut harness, "fuse");
    assert!(harness.query_by_label_contains("1 setting waits").is_some(), "that one is taken over at once");
    write(&mut harness, "voxel_size_m", "0.01");
    assert!(harness.query_by_label_contains("2 settings wait for a restart").is_some());
    let settings = changed(&mut harness).expect("it can be used");
    assert_eq!((settings.mode, settings.map.fuse), (Mode::SurfelsLoopClosure, false));
    click(&mut harness, "Restart to apply");
    assert_eq!(harness.state().actions, [SettingsAction::Restart(settings.clone())]);
    harness.state_mut().panel.set_in_force(Some(settings));
    harness.run();
    assert!(harness.query_by_label("Restart to apply").is_none());
}

#[test]
fn documentation_is_in_tooltips() {
    let mut harness = shown(&Settings::default());
    harness.get_by_label("map").hover();
    harness.run();
    assert!(harness.query_by_label("The volumetric map.").is_some());
    click(&mut harness, "map");
    harness.get_by_label("fuse").hover();
    harness.run();
    let tooltip = "Whether frames are fused into the map; off to find the camera in a map without changing it.";
    assert!(harness.query_by_label_contains(tooltip).is_some());
    assert!(harness.query_by_label_contains("map.fuse\nDefault: true").is_some());
    click(&mut harness, "swapping");
    harness.get_by_label("delete").hover();
    harness.run();
    assert!(harness.query_by_label_contains("longest time are deleted.").is_some());
}

#[test]
fn what_differs_is_copied_as_a_settings_file() {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = 0.01;
    settings.tracker.icp.max_steps_fine = 7;
    let mut harness = shown(&settings);
    harness.get_by_label("Copy as TOML").click();
    let mut copied = None;
    for _ in 0..4 {
        harness.step();
        copied = copied.or(harness.output().platform_output.commands.iter().find_map(|command| match command {
            OutputCommand::CopyText(text) => Some(text.clone()),
            _ => None,
        }));
    }
    let copied = copied.expect("it was copied");
    assert_eq!(copied, "[map]\nvoxel_size_m = 0.01\n\n[tracker.icp]\nmax_steps_fine = 7\n");
    assert_eq!(Settings::resolve(Some(("copied", &copied)), &[]), Ok(settings));
}

#[test]
fn all_that_is_written_can_be_drawn() {
    fn texts(group: &Group, all: &mut String) {
        all.push_str(&group.documentation);
        for entry in &group.entries {
            match entry {
                Entry::Group(group) => texts(group, all),
                Entry::Leaf(leaf) => all.push_str(&leaf.tooltip()),
            }
        }
    }
    let mut all = RESET.to_owned();
    texts(&form(), &mut all);
    all.retain(|c| !c.is_control());
    let harness = shown(&Settings::default());
    let font = egui::TextStyle::Body.resolve(&harness.ctx.global_style());
    let missing: String = harness.ctx.fonts_mut(|fonts| {
        let missing = |c: &char| !fonts.has_glyph(&font, *c);
        all.chars().filter(missing).collect()
    });
    assert!(missing.is_empty(), "{missing}");
}

#[test]
fn what_can_only_be_used_all_together_waits_all_together() {
    let settings = |overrides: &[&str]| {
        let overrides: Vec<String> = overrides.iter().map(|given| (*given).into()).collect();
        Settings::resolve(None, &overrides).expect("they can be used")
    };
    let mut panel = SettingsPanel::new(settings(&["surfels.dynamics.enabled=true"]));
    panel.set_in_force(Some(panel.settings().clone()));
    assert!(panel.waiting.is_empty());
    // More than is allowed as long as objects that move are looked for.
    panel.set_settings(settings(&["surfels.dynamics.fallen=99.0"]));
    assert_eq!(panel.waiting, ["surfels.dynamics.enabled", "surfels.dynamics.fallen"]);
    panel.set_in_force(None);
    assert!(panel.waiting.is_empty());
}
