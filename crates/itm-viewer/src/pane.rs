//! The large pane: the map, and how it is looked at.

use egui::{Area, Color32, Id, Key, Order, Pos2, Rect, Response, Sense, Stroke, Ui, Vec2};
use glam::{DVec2, DVec3};
use itm_slam::{Intrinsics, SubmapState};

use crate::app::Viewer;
use crate::bars::badge;
use crate::engine::Command;
use crate::engine::state::{Scene, Shown, State};
use crate::overlay::{Overlay, Projection, axes_in_corner, border};
use crate::theme;

/// How long after the last wheel turn or key the view still counts as moving, in seconds.
const MOVING_S: f64 = 0.15;
/// Radians a pane's height is worth as the pointer turns the view.
const TURN: f64 = 3.0;
/// Depth of drawn cameras, in metres.
const FRUSTUM_M: f64 = 0.25;
const KEYFRAME_M: f64 = 0.06;

impl Viewer {
    pub(crate) fn large_pane(&mut self, ui: &mut Ui) {
        let pane = ui.available_rect_before_wrap();
        let response = ui.interact(pane, ui.scope_id().with("pane"), Sense::click_and_drag());
        let scale = ui.ctx().pixels_per_point();
        let pixels = (pane.size() * scale).round().max(Vec2::splat(16.0));
        self.view.pane_pixels = (pixels.x as u32, pixels.y as u32);
        ui.painter().rect_filled(pane, 0.0, background(ui));
        if self.view.free {
            self.steer(ui, &response);
        } else {
            self.view.moving = false;
        }
        let shown = self.engine.state().shown.clone();
        if let Some(shown) = &shown {
            let rect = if shown.follows { fitted(&shown.camera, pane) } else { pane };
            if let Some(texture) = self.textures.of_canvas(&shown.canvas) {
                let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
                ui.painter().image(texture, rect, whole, Color32::WHITE);
            }
            let projection = Projection::new(&shown.camera, &shown.world_from_camera, rect);
            if response.double_clicked()
                && let Some(pixel) = response.interact_pointer_pos().and_then(|place| projection.pixel(place))
            {
                self.view.picking = true;
                self.engine.send(Command::Pick(Box::new(shown.clone()), pixel));
            }
            let state = self.engine.state();
            self.draw_over(ui, &state, shown, projection);
            if !shown.follows {
                axes_in_corner(&ui.painter().with_clip_rect(pane), pane, &shown.world_from_camera);
            }
        }
        let state = self.engine.state();
        if let Some(frame) = state.frame.as_ref().filter(|_| state.scene.has_frames()) {
            border(ui.painter(), pane, theme::verdict(frame.verdict));
        }
        let corner = Area::new(Id::unique("badge")).order(Order::Middle).fixed_pos(pane.left_top() + Vec2::splat(10.0));
        corner.interactable(false).show(ui.ctx(), |ui| {
            ui.set_max_width(0.6 * pane.width());
            badge(ui, &state);
        });
        if matches!(state.scene, Scene::Nothing) && state.busy.is_none() {
            drop(state);
            self.welcome(ui, pane);
        } else {
            drop(state);
        }
        let now_s = ui.input(|input| input.time);
        self.toasts.take(&self.engine.state(), now_s);
        self.toasts.show(ui.ctx(), pane);
        if ui.input(|input| !input.raw.hovered_files.is_empty()) {
            let shade = ui.visuals().selection.bg_fill.gamma_multiply(0.35);
            ui.painter().rect_filled(pane, 0.0, shade);
            let font = egui::FontId::proportional(22.0);
            let colour = ui.visuals().strong_text_color();
            ui.painter().text(pane.center(), egui::Align2::CENTER_CENTER, "Drop to open", font, colour);
        }
    }

    /// What to do where nothing is open.
    fn welcome(&mut self, ui: &mut Ui, pane: Rect) {
        let mut chosen = None;
        let middle = Rect::from_center_size(pane.center(), Vec2::new(440.0_f32.min(pane.width()), 280.0));
        ui.scope_builder(egui::UiBuilder::new().max_rect(middle), |ui| {
            ui.vertical_centered(|ui| {
                ui.heading("itm");
                ui.label("Dense RGB-D SLAM: a recording of a depth camera becomes a map, live.");
                ui.add_space(10.0);
                ui.label("Drop a recording here: a folder in the format of TUM RGB-D, ICL-NUIM or 7-Scenes, an .mcap file; or a saved map.");
                ui.add_space(10.0);
                if ui.button("Open…").clicked() {
                    chosen = Some(None);
                }
                ui.add_space(10.0);
                for path in &self.recent {
                    if ui.link(path.display().to_string()).clicked() {
                        chosen = Some(Some(path.clone()));
                    }
                }
                if self.recent.is_empty() {
                    ui.label("There is none yet? In a terminal, 'itm synth room' makes one of a furnished room.");
                }
                ui.add_space(10.0);
                ui.weak("? shows all keys");
            });
        });
        match chosen {
            Some(None) => self.act(&ui.ctx().clone(), crate::action::Action::Open),
            Some(Some(path)) => self.open_path(path),
            None => {}
        }
    }

    /// Moves the free camera as pointer, wheel and keys say.
    fn steer(&mut self, ui: &Ui, response: &Response) {
        let height = f64::from(response.rect.height().max(1.0));
        let now_s = ui.input(|input| input.time);
        let mut moved = false;
        let drag = response.drag_delta();
        let by = DVec2::new(drag.x.into(), drag.y.into()) / height;
        let (shift, command) = ui.input(|input| (input.modifiers.shift, input.modifiers.command));
        let camera = &mut self.view.camera;
        if by != DVec2::ZERO {
            moved = true;
            if response.dragged_by(egui::PointerButton::Middle) {
                camera.dolly((-4.0 * by.y).exp());
            } else if response.dragged_by(egui::PointerButton::Secondary) || shift {
                camera.pan(by);
            } else if command {
                camera.look_around(-TURN * by.x * 0.5, TURN * by.y * 0.5);
            } else {
                camera.orbit(TURN * by.x, TURN * by.y);
            }
        }
        if response.contains_pointer() {
            let (scroll, pinch) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
            if scroll != 0.0 || pinch != 1.0 {
                moved = true;
                camera.dolly(f64::from(pinch) * (f64::from(scroll) / 300.0).exp());
            }
        }
        if self.dialog.is_none() && !ui.ctx().egui_wants_keyboard_input() {
            moved |= steer_by_keys(ui, camera, shift);
        }
        if moved {
            self.view.placed = true;
            ui.data_mut(|data| data.insert_temp(response.id, now_s));
        }
        let last: f64 = ui.data(|data| data.get_temp(response.id)).unwrap_or(f64::NEG_INFINITY);
        // A held button is a view that goes on being moved.
        self.view.moving = now_s - last < MOVING_S || response.dragged();
        if self.view.moving {
            ui.ctx().request_repaint_after(std::time::Duration::from_millis(30));
        }
    }

    fn draw_over(&self, ui: &Ui, state: &State, shown: &Shown, projection: Projection) {
        let painter = ui.painter().with_clip_rect(ui.max_rect());
        let overlay = Overlay::new(&painter, projection);
        let show = self.view.overlay;
        if show.trajectory {
            overlay.path(&state.trajectory, theme::ACCENT, 1.6);
        }
        let lens = state.scene.depth_camera();
        if show.keyframes
            && let Some(lens) = &lens
        {
            let stroke = Stroke::new(1.0, theme::KEYFRAME.gamma_multiply(0.8));
            let near = |keyframe: &&itm_slam::Se3| {
                // The one that the camera is at would fill the pane.
                (keyframe.translation - shown.world_from_camera.translation).length() > 2.0 * KEYFRAME_M
            };
            for keyframe in state.keyframes.iter().filter(near) {
                overlay.frustum(lens, keyframe, KEYFRAME_M, stroke);
            }
        }
        if show.submaps && state.submaps.len() > 1 {
            for (from, to, closure) in &state.links {
                let at =
                    |number: &u16| state.submaps.get(usize::from(*number)).map(|s| s.world_from_submap.translation);
                if let (Some(from), Some(to)) = (at(from), at(to)) {
                    let colour = if *closure { theme::CLOSURE } else { theme::LINK };
                    overlay.segment(from, to, Stroke::new(if *closure { 2.5 } else { 1.5 }, colour));
                }
            }
            for (number, submap) in state.submaps.iter().enumerate() {
                let colour = theme::submap(submap.state);
                let at = submap.world_from_submap.translation;
                overlay.dot(at, if submap.state == SubmapState::Passive { 3.5 } else { 5.0 }, colour);
                overlay.label(at, &number.to_string(), colour);
            }
        }
        if let Some(frame) = state.frame.as_ref().filter(|_| show.camera && !shown.follows && state.scene.has_frames())
            && let (Some(pose), Some(lens)) = (&frame.world_from_camera, &lens)
        {
            overlay.frustum(lens, pose, FRUSTUM_M, Stroke::new(2.0, theme::verdict(frame.verdict)));
        }
        if !shown.follows && self.view.moving {
            overlay.cross(self.view.camera.pivot, 0.03 * self.view.camera.distance_m);
        }
    }
}

/// Turns and flies while keys are held; whether any is.
fn steer_by_keys(ui: &Ui, camera: &mut crate::camera::OrbitCamera, shift: bool) -> bool {
    let (dt, held) = ui.input(|input| {
        let held = [
            Key::ArrowLeft,
            Key::ArrowRight,
            Key::ArrowUp,
            Key::ArrowDown,
            Key::PageUp,
            Key::PageDown,
            Key::Plus,
            Key::Minus,
        ]
        .map(|key| input.key_down(key) || key == Key::Plus && input.key_down(Key::Equals));
        (f64::from(input.stable_dt.min(0.1)), held.map(|held| f64::from(u8::from(held))))
    });
    let [left, right, up, down, higher, lower, nearer, away] = held;
    if held.iter().all(|held| *held == 0.0) {
        return false;
    }
    let speed_m = dt * (0.6 * camera.distance_m).clamp(0.2, 3.0);
    if shift {
        camera.fly(DVec3::new(right - left, 0.0, up - down) * speed_m);
    } else {
        camera.orbit(dt * 1.5 * (right - left), dt * 1.5 * (down - up));
    }
    camera.fly(DVec3::new(0.0, lower - higher, 0.0) * speed_m);
    camera.dolly((1.5 * dt * (nearer - away)).exp());
    true
}

/// The largest rectangle of a camera's shape within a pane.
fn fitted(camera: &Intrinsics, pane: Rect) -> Rect {
    let size = Vec2::new(camera.width as f32, camera.height as f32);
    let scale = (pane.width() / size.x).min(pane.height() / size.y);
    Rect::from_center_size(pane.center(), size * scale)
}

/// Behind the map.
fn background(ui: &Ui) -> Color32 {
    if ui.visuals().dark_mode { Color32::from_rgb(24, 26, 30) } else { Color32::from_rgb(214, 218, 224) }
}
