//! The window.

use std::path::PathBuf;

use egui::{Context, Key, Modifiers, Theme, Ui};
use itm_io::recording::OpenOptions;
use itm_slam::{Settings, Shading};

use crate::action::{ACTIONS, Action};
use crate::camera::OrbitCamera;
use crate::dialog::{Chosen, Dialog, Purpose, With};
use crate::engine::state::{Scene, State};
use crate::engine::{CaptureKind, Command, Engine, Open, Wish};
use crate::plots::Plotted;
use crate::settings_panel::{SettingsAction, SettingsPanel};
use crate::textures::Textures;
use crate::toasts::Toasts;

/// How the map is shown, in the order in which the key goes through them.
pub(crate) const COLOURINGS: [(Shading, &str); 6] = [
    (Shading::Phong, "Shaded"),
    (Shading::Grey, "Grey"),
    (Shading::Colour, "Colours"),
    (Shading::Normals, "Normals"),
    (Shading::Depth, "Depth"),
    (Shading::Confidence, "Confidence"),
];

/// Files that were opened lately, at most so many.
const RECENT: usize = 10;

/// How far ahead of the recording's camera the free one's first pivot is, in metres.
const PIVOT_AHEAD_M: f64 = 1.5;

/// How the map is looked at.
#[derive(Clone, Debug)]
pub(crate) struct View {
    /// Whether the free camera is looked through; otherwise the recording's is followed.
    pub(crate) free: bool,
    pub(crate) camera: OrbitCamera,
    /// Place among [`COLOURINGS`].
    pub(crate) colouring: usize,
    /// The one submap that is shown.
    pub(crate) submap: Option<u16>,
    pub(crate) overlay: Overlays,
    /// The pane's size in pixels.
    pub(crate) pane_pixels: (u32, u32),
    /// Whether the view is being moved.
    pub(crate) moving: bool,
    /// Picks that were answered, and whether the next is waited for.
    pub(crate) picks: u64,
    pub(crate) picking: bool,
    /// Whether the free camera was placed by the user, or shows all since.
    pub(crate) placed: bool,
}

/// What is drawn over the map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Overlays {
    pub(crate) trajectory: bool,
    pub(crate) camera: bool,
    pub(crate) keyframes: bool,
    pub(crate) submaps: bool,
}

impl Default for View {
    fn default() -> Self {
        Self {
            free: false,
            camera: OrbitCamera::default(),
            colouring: 0,
            submap: None,
            overlay: Overlays { trajectory: true, camera: true, keyframes: true, submaps: true },
            pane_pixels: (640, 480),
            moving: false,
            picks: 0,
            picking: false,
            placed: false,
        }
    }
}

impl View {
    pub(crate) fn shading(&self) -> Shading {
        COLOURINGS[self.colouring].0
    }
}

/// The window's state.
pub(crate) struct Viewer {
    pub(crate) engine: Engine,
    pub(crate) textures: Textures,
    pub(crate) view: View,
    pub(crate) settings_panel: SettingsPanel,
    /// Settings for what is opened next.
    pub(crate) settings: Settings,
    pub(crate) options: OpenOptions,
    pub(crate) dialog: Option<Dialog>,
    pub(crate) toasts: Toasts,
    pub(crate) recent: Vec<PathBuf>,
    pub(crate) show_settings: bool,
    pub(crate) show_sidebar: bool,
    pub(crate) show_shortcuts: bool,
    pub(crate) plotted: Plotted,
    /// The frame under the scrub bar's handle while it is dragged.
    pub(crate) scrubbed: Option<usize>,
    /// How often something was opened, to find out that something else is.
    opened: u64,
    /// Whether the keyboard belonged to a widget or a menu in the last frame: its Escape does not close the window.
    typing: bool,
    /// Whether the window was asked to close.
    pub(crate) quits: bool,
    /// Whether the window is to close once what was reconstructed is kept.
    closing: bool,
}

impl Viewer {
    pub(crate) fn new(engine: Engine, textures: Textures, settings: Settings, options: OpenOptions) -> Self {
        Self {
            engine,
            textures,
            view: View::default(),
            settings_panel: SettingsPanel::new(settings.clone()),
            settings,
            options,
            dialog: None,
            toasts: Toasts::default(),
            recent: Vec::new(),
            show_settings: false,
            show_sidebar: true,
            show_shortcuts: false,
            plotted: Plotted::default(),
            scrubbed: None,
            opened: 0,
            typing: false,
            quits: false,
            closing: false,
        }
    }

    /// Opens what lies at a path.
    pub(crate) fn open(&mut self, open: Open) {
        self.engine.send(Command::Open(Box::new(open)));
    }

    /// Opens what lies at a path with the settings as they are.
    pub(crate) fn open_path(&mut self, path: PathBuf) {
        let open = Open { options: self.options.clone(), ..Open::new(path, &self.settings) };
        self.open(open);
    }

    /// Draws the window into all of a [`Ui`].
    pub(crate) fn ui(&mut self, ui: &mut Ui) {
        let ctx = ui.ctx().clone();
        self.close_when_kept(&ctx);
        self.notice_what_is_open();
        self.take_keys(&ctx);
        self.take_dropped_files(&ctx);
        self.toolbar(ui);
        self.bottom_bar(ui);
        if self.show_settings {
            self.settings_side(ui);
        }
        if self.show_sidebar {
            self.sidebar(ui);
        }
        egui::CentralPanel::default().frame(egui::Frame::NONE).show(ui, |ui| self.large_pane(ui));
        self.shortcut_sheet(&ctx);
        self.dialogs(&ctx);
        if self.closing {
            let notice = egui::Area::new(egui::Id::unique("closing")).order(egui::Order::Foreground);
            notice.anchor(egui::Align2::CENTER_CENTER, egui::Vec2::ZERO).show(&ctx, |ui| {
                egui::Frame::popup(ui.style()).show(ui, |ui| {
                    ui.horizontal(|ui| {
                        ui.spinner();
                        ui.heading("Closing once what was reconstructed is kept");
                    });
                });
            });
        }
        self.wish();
    }

    /// What changes where something else was opened, or it has grown so that it can be looked at.
    fn notice_what_is_open(&mut self) {
        let state = self.engine.state();
        let (opened, path) = &state.opened;
        if *opened != self.opened {
            self.opened = *opened;
            // The program may be started elsewhere the next time.
            let path = std::path::absolute(path).unwrap_or_else(|_| path.clone());
            self.recent.retain(|recent| *recent != path);
            self.recent.insert(0, path);
            self.recent.truncate(RECENT);
            if state.scene.has_map() {
                self.settings = state.asked.clone();
                self.settings_panel.set_settings(state.asked.clone());
            }
            // Nothing begins anew with a map, so that nothing waits for it.
            self.settings_panel.set_in_force(state.scene.has_frames().then(|| state.asked.clone()));
            self.view.submap = None;
            self.view.placed = false;
            // A map is there to be looked around in.
            self.view.free = self.view.free || matches!(state.scene, Scene::Map { .. } | Scene::Results { .. });
        }
        if self.view.submap.is_some_and(|submap| usize::from(submap) >= state.submaps.len()) {
            self.view.submap = None;
        }
        if !self.view.placed && self.view.free && state.bounds.is_some() {
            show_all(&mut self.view.camera, &state);
        }
        let (picks, point) = state.picked;
        if self.view.picking && picks != self.view.picks {
            self.view.picking = false;
            if let Some(point) = point {
                self.view.camera.look_at(point);
            }
        }
        self.view.picks = picks;
    }

    /// Tells the engine what is to be seen.
    fn wish(&mut self) {
        let far = f64::from(self.settings.view.max_depth_m);
        let free = self
            .view
            .free
            .then(|| (OrbitCamera::intrinsics(self.view.pane_pixels), self.view.camera.world_from_camera()));
        self.engine.wish(Wish {
            free,
            shading: self.view.shading(),
            // From outside of a room its far side is to be seen too.
            max_depth_m: (self.view.camera.distance_m + far).clamp(2.0, 60.0) as f32,
            submap: self.view.submap,
            moving: self.view.moving,
        });
    }

    fn take_keys(&mut self, ctx: &Context) {
        // A widget has lost the keyboard, or a menu will be closed, by the same Escape that comes here.
        let typing = ctx.egui_wants_keyboard_input() || egui::Popup::is_any_open(ctx);
        let typed = std::mem::replace(&mut self.typing, typing || self.dialog.is_some());
        let escapes = typed && ctx.input(|input| input.key_pressed(Key::Escape));
        if self.typing || escapes {
            return;
        }
        if self.show_shortcuts && ctx.input_mut(|input| input.consume_key(Modifiers::NONE, Key::Escape)) {
            self.show_shortcuts = false;
            return;
        }
        for about in ACTIONS {
            if about.keys.iter().any(|keys| ctx.input_mut(|input| input.consume_shortcut(keys))) {
                self.act(ctx, about.action);
            }
        }
    }

    /// Processes frames or not. The window shows it at once, though the frame at hand is ended first.
    fn run(&mut self, run: bool) {
        self.engine.state().running = run;
        self.engine.send(Command::Run(run));
    }

    /// Keeps the window open, and alive, until the results are written.
    fn close_when_kept(&mut self, ctx: &Context) {
        if ctx.input(|input| input.viewport().close_requested()) && !self.closing {
            self.closing = true;
            self.dialog = None;
            if !self.engine.begin_end() {
                ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
            }
        } else if self.closing {
            if self.engine.begin_end() {
                ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            } else {
                ctx.send_viewport_cmd(egui::ViewportCommand::CancelClose);
                ctx.request_repaint_after(std::time::Duration::from_millis(50));
            }
        }
    }

    fn take_dropped_files(&mut self, ctx: &Context) {
        let dropped: Vec<PathBuf> =
            ctx.input(|input| input.raw.dropped_files.iter().map(|file| file.path().to_owned()).collect());
        let Some(path) = dropped.into_iter().next() else { return };
        match &mut self.dialog {
            Some(dialog) => dialog.set_path(&path),
            None => self.open_dropped(path),
        }
    }

    /// A map that comes while a recording is open may be meant to be tracked in.
    fn open_dropped(&mut self, path: PathBuf) {
        let has_frames = self.engine.state().scene.has_frames();
        if has_frames && itm_io::map_file::is_map_file(&path) {
            self.dialog = Some(Dialog::new(Purpose::Load, path.display().to_string()));
        } else {
            self.open_path(path);
        }
    }

    /// Whether an action can be done at the moment.
    pub(crate) fn can(action: Action, state: &State) -> bool {
        let finished = matches!(state.scene, Scene::Recording { finished: true, .. });
        match action {
            Action::RunOrPause | Action::Run | Action::Step => state.scene.has_frames() && !finished,
            Action::Fusion | Action::Reset => state.scene.has_frames(),
            Action::Save | Action::Mesh => state.scene.has_map(),
            Action::PreviousSubmap | Action::NextSubmap => state.submaps.len() > 1,
            Action::RecordFrames | Action::RecordVideo => state.shown.is_some(),
            _ => true,
        }
    }

    /// Does what a key or a button asks for; nothing where that cannot be.
    pub(crate) fn act(&mut self, ctx: &Context, action: Action) {
        let state = self.engine.state();
        if !Self::can(action, &state) {
            return;
        }
        let (running, fusing, submaps) = (state.running, state.fusing, state.submaps.len() as u16);
        let name = state.scene.name().unwrap_or("map").to_owned();
        let capturing = state.recording.is_some();
        if action == Action::ShowAll {
            show_all(&mut self.view.camera, &state);
            (self.view.free, self.view.placed) = (true, true);
        }
        if action == Action::View {
            self.view.free = !self.view.free;
            let pose = state.frame.as_ref().and_then(|frame| frame.world_from_camera);
            if let Some(pose) = pose.filter(|_| self.view.free && !self.view.placed) {
                // From where the camera is, so that one sees where one is.
                self.view.camera = OrbitCamera::at(&pose, PIVOT_AHEAD_M);
                self.view.placed = true;
            }
        }
        drop(state);
        match action {
            Action::Open => self.dialog = Some(Dialog::new(Purpose::Open, String::new())),
            Action::RunOrPause => self.run(!running),
            Action::Run => self.run(true),
            Action::Step => self.engine.send(Command::Step),
            Action::Fusion => {
                self.settings.map.fuse = !fusing;
                self.settings_panel.set_settings(self.settings.clone());
                self.engine.send(Command::Fuse(!fusing));
            }
            Action::Reset => self.engine.send(Command::Restart(Box::new(self.settings.clone()))),
            Action::View | Action::ShowAll => {}
            Action::Colouring => self.view.colouring = (self.view.colouring + 1) % COLOURINGS.len(),
            Action::PreviousSubmap => {
                self.view.submap = match self.view.submap {
                    None => submaps.checked_sub(1),
                    Some(number) => number.checked_sub(1),
                };
            }
            Action::NextSubmap => {
                self.view.submap = match self.view.submap {
                    None => Some(0),
                    Some(number) => Some(number + 1).filter(|next| *next < submaps),
                };
            }
            Action::Save => self.dialog = Some(Dialog::new(Purpose::Save, format!("{name}.itm"))),
            Action::Load => self.dialog = Some(Dialog::new(Purpose::Load, String::new())),
            Action::Mesh => self.dialog = Some(Dialog::new(Purpose::Mesh, format!("{name}.ply"))),
            Action::RecordFrames | Action::RecordVideo if capturing => self.engine.send(Command::Capture(None)),
            Action::RecordFrames => self.dialog = Some(Dialog::new(Purpose::Frames, format!("{name}-frames"))),
            Action::RecordVideo => self.dialog = Some(Dialog::new(Purpose::Video, format!("{name}.avi"))),
            Action::Settings => self.show_settings = !self.show_settings,
            Action::Sidebar => self.show_sidebar = !self.show_sidebar,
            Action::Shortcuts => self.show_shortcuts = !self.show_shortcuts,
            Action::Theme => {
                let dark = ctx.theme() == Theme::Dark;
                ctx.set_theme(if dark { Theme::Light } else { Theme::Dark });
            }
            Action::Quit => {
                self.quits = true;
                ctx.send_viewport_cmd(egui::ViewportCommand::Close);
            }
        }
    }

    /// Shows the dialog that is open, and does what was chosen in it.
    fn dialogs(&mut self, ctx: &Context) {
        let Some(dialog) = &mut self.dialog else { return };
        let has_frames = self.engine.state().scene.has_frames();
        let Some(chosen) = dialog.show(ctx, &self.recent, has_frames) else { return };
        let purpose = dialog.purpose();
        self.dialog = None;
        let Chosen::Path { path, with } = chosen else { return };
        match purpose {
            Purpose::Open => self.open_path(path),
            Purpose::Load => match with {
                With::LookingAt => self.open_path(path),
                With::TrackingIn => self.engine.send(Command::TrackIn(path)),
                With::GoingOn => self.engine.send(Command::GoOn(path)),
            },
            Purpose::Save => self.engine.send(Command::Save(path)),
            Purpose::Mesh => self.engine.send(Command::Mesh(path)),
            Purpose::Frames => self.engine.send(Command::Capture(Some((CaptureKind::Frames, path)))),
            Purpose::Video => self.engine.send(Command::Capture(Some((CaptureKind::Video, path)))),
        }
    }

    fn settings_side(&mut self, ui: &mut Ui) {
        let action = egui::Panel::left("settings")
            .default_size(360.0)
            .size_range(260.0..=640.0)
            .show(ui, |ui| self.settings_panel.ui(ui))
            .inner;
        match action {
            Some(SettingsAction::Changed(settings)) => {
                self.engine.send(Command::Settings(Box::new(settings.clone())));
                self.settings = settings;
            }
            Some(SettingsAction::Restart(settings)) => {
                self.engine.send(Command::Restart(Box::new(settings.clone())));
                self.settings = settings;
            }
            None => {}
        }
    }
}

/// Places the free camera so that everything is in view.
fn show_all(camera: &mut OrbitCamera, state: &State) {
    if let Some((min, max)) = state.bounds {
        camera.frame(min, max);
    }
}

impl eframe::App for Viewer {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.ui(ui);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        eframe::set_value(storage, "recent", &self.recent);
    }

    fn on_exit(&mut self) {
        self.engine.end();
    }
}
