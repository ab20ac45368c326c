//! Asking for a file.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, TryRecvError};

use egui::{Context, Id, Key, Modal, RichText, TextEdit, Ui};

/// What a file is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    Open,
    Load,
    Save,
    Mesh,
    Frames,
    Video,
}

/// What was chosen.
pub(crate) enum Chosen {
    Nothing,
    Path { path: PathBuf, with: With },
}

/// What is done with a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum With {
    LookingAt,
    /// The open recording is started again in it.
    TrackingIn,
    /// Its session goes on with the frames of the open recording that are left.
    GoingOn,
}

/// A dialog that asks for a path: typed, dropped or browsed for.
pub(crate) struct Dialog {
    purpose: Purpose,
    text: String,
    /// What the system's own dialog answers.
    browsed: Option<Receiver<Option<PathBuf>>>,
    /// Whether the text was shown, and has the keyboard.
    begun: bool,
}

impl Purpose {
    fn title(self) -> &'static str {
        match self {
            Self::Open => "Open a recording, a map or the results of a run",
            Self::Load => "Load a map",
            Self::Save => "Save the map",
            Self::Mesh => "Write a mesh",
            Self::Frames => "Record pictures into a folder",
            Self::Video => "Record a video",
        }
    }

    fn explains(self) -> &'static str {
        match self {
            Self::Open => {
                "A folder in the format of TUM RGB-D, ICL-NUIM or 7-Scenes, or of images with a calibration.txt; an .mcap \
                 file; a map (.itm); or the folder that itm run has written."
            }
            Self::Load => "A map that was saved before (.itm).",
            Self::Save => {
                "The map, its keyframes and the trajectory; 'itm run --resume' and this window (Load) go on with it."
            }
            Self::Mesh => "The name's ending says the format: .ply, .glb, .obj or .stl.",
            Self::Frames => "A PNG file for each new picture of the large pane, in an empty folder or a new one.",
            Self::Video => "An .avi file (Motion JPEG) with each new picture of the large pane.",
        }
    }

    fn button(self) -> &'static str {
        match self {
            Self::Open => "Open",
            Self::Load => "Look at it",
            Self::Save => "Save",
            Self::Mesh => "Write",
            Self::Frames | Self::Video => "Record",
        }
    }
}

impl Dialog {
    pub(crate) fn new(purpose: Purpose, text: String) -> Self {
        Self { purpose, text, browsed: None, begun: false }
    }

    pub(crate) fn purpose(&self) -> Purpose {
        self.purpose
    }

    /// Takes a path that was dropped.
    pub(crate) fn set_path(&mut self, path: &Path) {
        self.text = path.display().to_string();
    }

    /// Shows it; what was chosen once something was.
    pub(crate) fn show(&mut self, ctx: &Context, recent: &[PathBuf], has_frames: bool) -> Option<Chosen> {
        self.take_browsed();
        let modal = Modal::new(Id::unique("path dialog")).show(ctx, |ui| self.contents(ui, recent, has_frames));
        if modal.inner.is_some() {
            return modal.inner;
        }
        modal.should_close().then_some(Chosen::Nothing)
    }

    fn contents(&mut self, ui: &mut Ui, recent: &[PathBuf], has_frames: bool) -> Option<Chosen> {
        ui.set_width(520.0);
        ui.heading(self.purpose.title());
        ui.label(self.purpose.explains());
        ui.add_space(6.0);
        let mut chosen = None;
        let text = self.text.trim();
        let replaces = matches!(self.purpose, Purpose::Save | Purpose::Mesh | Purpose::Video)
            && !text.is_empty()
            && Path::new(text).exists();
        ui.horizontal(|ui| {
            let width = ui.available_width() - if self.purpose == Purpose::Open { 130.0 } else { 90.0 };
            let edit = ui.add(TextEdit::singleline(&mut self.text).desired_width(width).hint_text("path"));
            if !self.begun {
                self.begun = true;
                edit.request_focus();
            }
            let entered = edit.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            // What is there already is replaced by the button that says so alone.
            if entered && !self.text.trim().is_empty() && !replaces {
                chosen = Some(self.path(With::LookingAt));
            }
            let system = "The system's own dialog, where there is one";
            if self.purpose == Purpose::Open {
                if ui.button("Folder…").on_hover_text(system).clicked() {
                    self.browse(true);
                }
                if ui.button("File…").on_hover_text(system).clicked() {
                    self.browse(false);
                }
            } else if ui.button("Browse…").on_hover_text(system).clicked() {
                self.browse(self.purpose == Purpose::Frames);
            }
        });
        if replaces {
            ui.colored_label(ui.visuals().warn_fg_color, "There is a file of that name.");
        }
        if self.purpose == Purpose::Open && !recent.is_empty() {
            ui.add_space(6.0);
            ui.label(RichText::new("Recently open").strong());
            for path in recent {
                if ui.link(path.display().to_string()).clicked() {
                    chosen = Some(Chosen::Path { path: path.clone(), with: With::LookingAt });
                }
            }
        }
        ui.add_space(8.0);
        ui.horizontal(|ui| {
            let there = !self.text.trim().is_empty();
            if self.purpose == Purpose::Load && has_frames {
                let button = ui.add_enabled(there, egui::Button::new("Track this recording in it"));
                if button.on_hover_text("Start the recording again, with the camera looked for in that map").clicked() {
                    chosen = Some(self.path(With::TrackingIn));
                }
                let button = ui.add_enabled(there, egui::Button::new("Go on with it"));
                if button
                    .on_hover_text("Reconstruct the frames of this recording that come after the map's last")
                    .clicked()
                {
                    chosen = Some(self.path(With::GoingOn));
                }
            }
            let label = if replaces { "Replace" } else { self.purpose.button() };
            if ui.add_enabled(there, egui::Button::new(label)).clicked() {
                chosen = Some(self.path(With::LookingAt));
            }
            if ui.button("Cancel").clicked() {
                chosen = Some(Chosen::Nothing);
            }
        });
        chosen
    }

    fn path(&self, with: With) -> Chosen {
        Chosen::Path { path: PathBuf::from(self.text.trim()), with }
    }

    /// Asks the system, on a thread: its dialog may stay open as long as it likes.
    fn browse(&mut self, folder: bool) {
        let (sender, receiver) = mpsc::channel();
        let (purpose, text) = (self.purpose, self.text.clone());
        std::thread::spawn(move || {
            let dialog = rfd::FileDialog::new().set_title(purpose.title());
            let path = match purpose {
                Purpose::Open | Purpose::Frames if folder => dialog.pick_folder(),
                Purpose::Open | Purpose::Frames => {
                    dialog.add_filter("recording or map", &["mcap", "itm"]).add_filter("all", &["*"]).pick_file()
                }
                Purpose::Load => dialog.add_filter("map", &["itm"]).pick_file(),
                Purpose::Save => dialog.add_filter("map", &["itm"]).set_file_name(text).save_file(),
                Purpose::Mesh => {
                    dialog.add_filter("mesh", &["ply", "glb", "obj", "stl"]).set_file_name(text).save_file()
                }
                Purpose::Video => dialog.add_filter("video", &["avi"]).set_file_name(text).save_file(),
            };
            // Nobody listens where the dialog was closed meanwhile.
            let _closed = sender.send(path);
        });
        self.browsed = Some(receiver);
    }

    fn take_browsed(&mut self) {
        match self.browsed.as_ref().map(Receiver::try_recv) {
            Some(Ok(path)) => {
                if let Some(path) = path {
                    self.text = path.display().to_string();
                }
                self.browsed = None;
            }
            Some(Err(TryRecvError::Disconnected)) => self.browsed = None,
            Some(Err(TryRecvError::Empty)) | None => {}
        }
    }
}
