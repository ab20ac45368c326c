//! The bars above and below, and the sheet of shortcuts.

use egui::{Align, Button, ComboBox, Context, Layout, ProgressBar, RichText, Slider, Ui};

use crate::action::{ACTIONS, About, Action, VIEW_HELP};
use crate::app::{COLOURINGS, Viewer};
use crate::engine::Command;
use crate::engine::state::{Scene, State};
use crate::theme;

/// A button for an action, with what it does and its keys as tooltip.
fn button(ui: &mut Ui, about: &About, label: &str, state: &State, chosen: bool) -> bool {
    let enabled = Viewer::can(about.action, state);
    let button = ui.add_enabled(enabled, Button::new(label).selected(chosen));
    button.on_hover_text(about.tooltip()).on_disabled_hover_text(about.tooltip()).clicked()
}

impl Viewer {
    /// The buttons.
    pub(crate) fn toolbar(&mut self, ui: &mut Ui) {
        let mut asked = None;
        egui::Panel::top("tools").show(ui, |ui| {
            ui.add_space(3.0);
            ui.horizontal_wrapped(|ui| {
                ui.spacing_mut().item_spacing.x = 5.0;
                let guard = self.engine.state();
                let state = &*guard;
                let mut put = |ui: &mut Ui, action: Action, label: Option<&str>, chosen: bool| {
                    let about = action.about();
                    if button(ui, about, label.unwrap_or(about.label), state, chosen) {
                        asked = Some(action);
                    }
                };
                put(ui, Action::Open, None, false);
                ui.separator();
                put(ui, Action::RunOrPause, state.running.then_some("⏸ Pause"), false);
                put(ui, Action::Step, None, false);
                put(ui, Action::Reset, None, false);
                put(ui, Action::Fusion, None, state.fusing && state.scene.has_frames());
                ui.separator();
                put(ui, Action::View, None, self.view.free);
                put(ui, Action::ShowAll, None, false);
                let combo =
                    ComboBox::from_id_salt("colouring").width(92.0).selected_text(COLOURINGS[self.view.colouring].1);
                let combo = combo.show_ui(ui, |ui| {
                    for (place, (_, name)) in COLOURINGS.iter().enumerate() {
                        ui.selectable_value(&mut self.view.colouring, place, *name);
                    }
                });
                combo.response.on_hover_text(Action::Colouring.about().tooltip());
                if state.submaps.len() > 1 {
                    put(ui, Action::PreviousSubmap, None, false);
                    let shown =
                        self.view.submap.map_or_else(|| "All submaps".into(), |number| format!("Submap {number}"));
                    ui.label(shown);
                    put(ui, Action::NextSubmap, None, false);
                }
                ui.menu_button("Overlays", |ui| {
                    let overlay = &mut self.view.overlay;
                    ui.checkbox(&mut overlay.trajectory, "Trajectory").on_hover_text("Where the camera was");
                    ui.checkbox(&mut overlay.camera, "Camera").on_hover_text("What the camera sees now");
                    ui.checkbox(&mut overlay.keyframes, "Keyframes").on_hover_text("Places that can be found again");
                    ui.checkbox(&mut overlay.submaps, "Submaps and links")
                        .on_hover_text("Where submaps lie, and what was measured between them");
                })
                .response
                .on_hover_text("What is drawn over the map");
                ui.separator();
                put(ui, Action::Load, None, false);
                put(ui, Action::Save, None, false);
                put(ui, Action::Mesh, None, false);
                if let Some((_, pictures)) = &state.recording {
                    put(ui, Action::RecordFrames, Some(&format!("⏹ {pictures}")), true);
                } else {
                    ui.menu_button("Record", |ui| {
                        put(ui, Action::RecordFrames, None, false);
                        put(ui, Action::RecordVideo, None, false);
                    });
                }
                ui.separator();
                put(ui, Action::Settings, None, self.show_settings);
                put(ui, Action::Sidebar, None, self.show_sidebar);
                put(ui, Action::Theme, None, false);
                put(ui, Action::Shortcuts, None, self.show_shortcuts);
            });
            ui.add_space(2.0);
        });
        if let Some(action) = asked {
            self.act(&ui.ctx().clone(), action);
        }
    }

    /// Progress through the recording, and how it goes.
    pub(crate) fn bottom_bar(&mut self, ui: &mut Ui) {
        let mut command = None;
        egui::Panel::bottom("progress").show(ui, |ui| {
            ui.add_space(3.0);
            ui.horizontal(|ui| {
                let guard = self.engine.state();
                let state = &*guard;
                ui.label(RichText::new(state.scene.name().unwrap_or("nothing open")).strong()).on_hover_text(
                    if state.scene.about().is_empty() { "Open a recording or a map" } else { state.scene.about() },
                );
                if let Some(busy) = &state.busy {
                    ui.spinner();
                    match busy.done {
                        Some(done) => {
                            ui.add(ProgressBar::new(done).text(busy.what.as_str()).desired_width(240.0));
                        }
                        None => {
                            ui.label(&busy.what);
                        }
                    }
                    return;
                }
                let Scene::Recording { frames, next, finished, .. } = &state.scene else { return };
                if *finished {
                    ui.weak("finished");
                }
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    ui.label(rates(state));
                    let place = self.scrubbed.unwrap_or(*next).min(frames.end.saturating_sub(1));
                    ui.monospace(format!("{place} / {}", frames.end - 1));
                    let mut chosen = place;
                    ui.spacing_mut().slider_width = (ui.available_width() - 12.0).max(60.0);
                    let range = frames.start..=frames.end.saturating_sub(1);
                    let slider = ui.add(Slider::new(&mut chosen, range).show_value(false).trailing_fill(true));
                    let slider = slider
                        .on_hover_text("Drag to go on with another frame: the map stays, and the camera is looked for");
                    if (slider.dragged() || slider.changed()) && Some(chosen) != self.scrubbed && chosen != place {
                        self.scrubbed = Some(chosen);
                        command = Some(Command::Preview(chosen));
                    }
                    if !slider.dragged()
                        && let Some(frame) = self.scrubbed.take()
                    {
                        command = Some(Command::Seek(frame));
                    }
                });
            });
            ui.add_space(1.0);
        });
        if let Some(command) = command {
            self.engine.send(command);
        }
    }

    /// All keys, and what the mouse does.
    pub(crate) fn shortcut_sheet(&mut self, ctx: &Context) {
        let mut open = self.show_shortcuts;
        egui::Window::new("Keys").open(&mut open).resizable(false).collapsible(false).show(ctx, |ui| {
            ui.horizontal_top(|ui| {
                egui::Grid::new("keys").striped(true).show(ui, |ui| {
                    for about in ACTIONS {
                        ui.monospace(about.shown_keys());
                        ui.label(about.does);
                        ui.end_row();
                    }
                });
                ui.separator();
                ui.vertical(|ui| {
                    ui.label(RichText::new("In the free view").strong());
                    egui::Grid::new("mouse").striped(true).show(ui, |ui| {
                        for (what, does) in VIEW_HELP {
                            ui.label(*what);
                            ui.label(*does);
                            ui.end_row();
                        }
                    });
                });
            });
        });
        self.show_shortcuts = open;
    }
}

/// Frame rate, by the last frames' times, and the map's size.
fn rates(state: &State) -> String {
    let times: Vec<f64> = state.rows.iter().rev().take(30).filter_map(|row| row.total_ms).collect();
    let mean_ms = times.iter().sum::<f64>() / times.len().max(1) as f64;
    let size = state.rows.iter().rev().find_map(|row| row.size);
    let unit = if state.settings.mode.has_surfels() { "surfels" } else { "blocks" };
    let mut text = String::new();
    if mean_ms > 0.0 {
        text.push_str(&format!("{:.1} frames/s", 1e3 / mean_ms));
    }
    if let Some(size) = size {
        text.push_str(&format!(" · {size} {unit}"));
    }
    if let Some(mib) = state.rows.iter().rev().find_map(|row| row.map_mib) {
        text.push_str(&format!(" · {mib:.0} MiB"));
    }
    text
}

/// The verdict in the corner of the large pane.
pub(crate) fn badge(ui: &mut Ui, state: &State) {
    let Some(frame) = &state.frame else { return };
    if !state.scene.has_frames() {
        return;
    }
    let colour = theme::verdict(frame.verdict);
    egui::Frame::popup(ui.style()).stroke(egui::Stroke::new(1.5, colour)).show(ui, |ui| {
        ui.horizontal(|ui| {
            ui.label(RichText::new("⏺").color(colour));
            ui.label(RichText::new(format!("tracking {}", frame.verdict.name())).strong());
            ui.label(format!("frame {}", frame.index));
        });
        for reason in &frame.reasons {
            ui.label(RichText::new(reason).small());
        }
    });
}
