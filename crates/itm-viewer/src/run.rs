//! Opening the window.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use eframe::egui_wgpu::{WgpuConfiguration, WgpuSetup, WgpuSetupCreateNew, wgpu};
use egui::{ColorImage, Context, ViewportCommand};
use itm_io::recording::OpenOptions;
use itm_slam::{Device, Poses, Settings, Shading};

use crate::app::{COLOURINGS, Viewer};
use crate::engine::state::Scene;
use crate::engine::{Engine, Open};
use crate::keeper::KeeperFor;
use crate::textures::Textures;

/// What the window begins with.
pub struct Options {
    /// What is opened: a recording, a map or the results of a run; nothing if `None`.
    pub path: Option<PathBuf>,
    /// How recordings are read.
    pub recordings: OpenOptions,
    /// How they are reconstructed. `device.adapter` says which adapter serves the window too.
    pub settings: Settings,
    /// Where their poses come from.
    pub poses: Poses,
    /// The first frame, by its place in the recording, and the one after the last; up to the recording's end if `None`.
    pub frames: (usize, Option<usize>),
    /// Whether frames are processed at once.
    pub run: bool,
    /// Whether the free view is shown, and not the recording's camera.
    pub free_view: bool,
    /// How the map is shown at first.
    pub shading: Shading,
    /// Keeps the results of each reconstruction.
    pub keeper_for: Option<KeeperFor>,
    /// Writes a picture of the window to this PNG file once no more frames come, and closes it.
    pub picture: Option<PathBuf>,
    /// The window's size in points.
    pub size: (f32, f32),
    /// A switch that closes the window when set, from any thread.
    pub stop: Arc<AtomicBool>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            path: None,
            recordings: OpenOptions::default(),
            settings: Settings::default(),
            poses: Poses::Tracked,
            frames: (0, None),
            run: true,
            free_view: false,
            shading: Shading::Phong,
            keeper_for: None,
            picture: None,
            size: (1280.0, 800.0),
            stop: Arc::default(),
        }
    }
}

/// Why there is no window.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no display, or no adapter that can show a window and run the stages.
    #[error("no window can be opened: {reason}")]
    NoWindow {
        /// Why not.
        reason: String,
    },
    /// The picture of the window could not be written.
    #[error("no picture of the window in '{}': {reason}", path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
}

/// Opens the window, and returns once it is closed and what was reconstructed is kept.
///
/// # Errors
/// Where no window can be opened: there is no display, or no adapter fits. Whatever goes wrong later is said in the window.
pub fn run(options: Options) -> Result<(), Error> {
    let adapter = options.settings.device.adapter.clone();
    let (width, height) = options.size;
    let mut setup = WgpuSetupCreateNew::without_display_handle();
    setup.instance_descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    setup.native_adapter_selector = Some(Arc::new(move |adapters, surface| {
        let shows = |adapter: &&wgpu::Adapter| surface.is_none_or(|surface| adapter.is_surface_supported(surface));
        let fit: Vec<wgpu::Adapter> = adapters.iter().filter(shows).cloned().collect();
        Device::choose(fit, &adapter).map_err(|error| error.to_string())
    }));
    setup.device_descriptor = Arc::new(Device::descriptor);
    let native = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("itm")
            .with_app_id("itm")
            .with_inner_size([width, height])
            .with_min_inner_size([480.0, 360.0])
            .with_drag_and_drop(true),
        wgpu_options: WgpuConfiguration { wgpu_setup: WgpuSetup::CreateNew(setup), ..WgpuConfiguration::default() },
        // A window that is pictured is as large as was asked for.
        persist_window: options.picture.is_none(),
        ..eframe::NativeOptions::default()
    };
    let picture = options.picture.clone();
    let outcome = Arc::new(std::sync::Mutex::new(None));
    let told = Arc::clone(&outcome);
    let opened = eframe::run_native(
        "itm",
        native,
        Box::new(move |creation| Ok(Box::new(Window::new(creation, options, told)?))),
    );
    opened.map_err(|error| Error::NoWindow { reason: error.to_string() })?;
    let outcome = outcome.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
    match (picture, outcome) {
        (None, _) | (Some(_), Some(Ok(()))) => Ok(()),
        (Some(picture), Some(Err(reason))) => Err(Error::Picture { path: picture, reason }),
        (Some(picture), None) => Err(Error::Picture { path: picture, reason: "the window was closed before".into() }),
    }
}

/// How long the window may lag behind the reconstruction on a software driver.
const SOFTWARE_PAUSE: Duration = Duration::from_millis(250);

/// What became of the picture.
type Outcome = Arc<std::sync::Mutex<Option<Result<(), String>>>>;

/// The viewer in a window of the system's.
struct Window {
    viewer: Viewer,
    picture: Option<PathBuf>,
    /// Whether something was asked to be opened.
    opens: bool,
    outcome: Outcome,
    stop: Arc<AtomicBool>,
    device: Device,
    /// The window's size in pixels at its last frame, and whether the device is held for a new one.
    size: egui::Vec2,
    holds: bool,
    /// Frames of the window that were drawn since all was there to be pictured.
    settled: u32,
}

impl Window {
    fn new(creation: &eframe::CreationContext<'_>, options: Options, outcome: Outcome) -> Result<Self, String> {
        let render_state = creation.wgpu_render_state.clone().ok_or("the window draws without a graphics device")?;
        let (device, queue) = (render_state.device.clone(), render_state.queue.clone());
        let device =
            Device::from_wgpu(device, queue, &render_state.adapter.get_info()).map_err(|error| error.to_string())?;
        let ctx = creation.egui_ctx.clone();
        // Drawing the window takes a software driver as long as a frame takes its stages: then it is drawn a few times a second
        // while nobody touches it.
        let pause = if device.capabilities().software { SOFTWARE_PAUSE } else { Duration::ZERO };
        let engine = Engine::start(&device, options.keeper_for, move |soon| {
            ctx.request_repaint_after(if soon { Duration::ZERO } else { pause });
        });
        let mut viewer = Viewer::new(
            engine,
            Textures::new(Some(render_state)),
            options.settings.clone(),
            options.recordings.clone(),
        );
        if let Some(recent) = creation.storage.and_then(|storage| eframe::get_value(storage, "recent")) {
            viewer.recent = recent;
        }
        viewer.view.free = options.free_view;
        viewer.view.colouring = COLOURINGS.iter().position(|(shading, _)| *shading == options.shading).unwrap_or(0);
        let opens = options.path.is_some();
        if let Some(path) = options.path {
            viewer.open(Open {
                options: options.recordings,
                poses: options.poses,
                frames: options.frames,
                run: options.run,
                ..Open::new(path, &options.settings)
            });
        }
        Ok(Self {
            viewer,
            picture: options.picture,
            opens,
            outcome,
            stop: options.stop,
            device,
            size: egui::Vec2::ZERO,
            holds: false,
            settled: 0,
        })
    }

    /// Keeps the reconstruction from the device while the window's surface is configured, which happens after the first frame of a
    /// new size has been laid out, and would fail.
    fn hold_for_new_size(&mut self, ctx: &Context) {
        let size = ctx.content_rect().size() * ctx.pixels_per_point();
        let changed = size != self.size;
        self.size = size;
        if changed || self.holds {
            self.device.hold(changed);
            self.holds = changed;
        }
        if changed {
            ctx.request_repaint();
        }
    }

    /// Takes the picture once everything is there, and closes the window.
    fn take_picture(&mut self, ctx: &Context) {
        let Some(picture) = &self.picture else { return };
        let there = {
            let state = self.viewer.engine.state();
            let failed = matches!(state.scene, Scene::Nothing) && state.busy.is_none() && state.told > 0;
            let done = match &state.scene {
                Scene::Nothing => failed || !self.opens,
                Scene::Recording { finished, .. } => state.shown.is_some() && *finished,
                Scene::Map { .. } => state.shown.is_some(),
                Scene::Results { .. } => true,
            };
            done && state.busy.is_none() && (state.is_finest || state.shown.is_none())
        };
        self.settled = if there { self.settled + 1 } else { 0 };
        // Time for panels to find their sizes.
        const SETTLED: u32 = 8;
        if self.settled == SETTLED {
            let (picture, outcome, ctx_of_picture) = (picture.clone(), Arc::clone(&self.outcome), ctx.clone());
            ctx.request_screenshot(move |image| {
                let written = write_png(&picture, &image);
                *outcome.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(written);
                ctx_of_picture.send_viewport_cmd(ViewportCommand::Close);
            });
        }
        ctx.request_repaint_after(Duration::from_millis(if there { 25 } else { 500 }));
    }
}

fn write_png(path: &Path, image: &ColorImage) -> Result<(), String> {
    let [width, height] = image.size;
    let rgb: Vec<u8> = image.pixels.iter().flat_map(|pixel| [pixel.r(), pixel.g(), pixel.b()]).collect();
    let image = image::RgbImage::from_raw(width as u32, height as u32, rgb).ok_or("the picture has another size")?;
    image.save_with_format(path, image::ImageFormat::Png).map_err(|error| error.to_string())
}

impl eframe::App for Window {
    fn ui(&mut self, ui: &mut egui::Ui, frame: &mut eframe::Frame) {
        eframe::App::ui(&mut self.viewer, ui, frame);
        self.hold_for_new_size(&ui.ctx().clone());
        self.take_picture(&ui.ctx().clone());
        if self.stop.load(Ordering::Relaxed) {
            ui.ctx().send_viewport_cmd(ViewportCommand::Close);
        }
        // It may be set while nothing else happens.
        ui.ctx().request_repaint_after(Duration::from_millis(500));
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        self.viewer.save(storage);
    }

    fn on_exit(&mut self) {
        self.device.hold(false);
        self.viewer.on_exit();
    }
}
