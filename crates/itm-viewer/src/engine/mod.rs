//! What runs beside the window: a thread that has the reconstruction, takes commands, and says what there is to see.
//!
//! The window never waits for it: it sends commands, wishes for a view, and reads a [`State`].

mod capture;
mod open;
mod opening;
mod painter;
mod pictures;
mod results;
pub(crate) mod state;
#[cfg(test)]
mod tests;
mod work;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use itm_slam::{Device, Intrinsics, Se3, Settings, Shading};

use crate::keeper::KeeperFor;
pub(crate) use capture::CaptureKind;
pub(crate) use open::Open;
pub(crate) use pictures::scale_colour;
use state::{Shown, State};

/// What the window asks for.
#[derive(Debug)]
pub(crate) enum Command {
    /// Something else is opened, in place of what is.
    Open(Box<Open>),
    /// The recording is started again, with these settings.
    Restart(Box<Settings>),
    /// The recording is started again in a saved map, with its settings.
    TrackIn(PathBuf),
    /// The session of a saved map goes on with the recording's frames that are left, with its settings.
    GoOn(PathBuf),
    /// Frames are processed until there are no more, or not.
    Run(bool),
    /// One frame is processed.
    Step,
    /// The frame to go on with.
    Seek(usize),
    /// The images of a frame are shown, as the scrub bar is dragged.
    Preview(usize),
    /// Whether frames are fused.
    Fuse(bool),
    /// Settings that hold from the next frame on; those that need a restart are left.
    Settings(Box<Settings>),
    /// The point that a pixel of a picture shows is asked for.
    Pick(Box<Shown>, (u32, u32)),
    /// The map is saved.
    Save(PathBuf),
    /// The map's surface is written.
    Mesh(PathBuf),
    /// Each new picture is recorded, until it is asked to end.
    Capture(Option<(CaptureKind, PathBuf)>),
    /// The wish for a view has changed.
    Look,
}

/// The view that the window wishes for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wish {
    /// The free camera's lens, for a picture as large as the pane, and its pose; `None` to follow the recording's camera.
    pub(crate) free: Option<(Intrinsics, Se3)>,
    pub(crate) shading: Shading,
    /// How far is seen, in metres.
    pub(crate) max_depth_m: f32,
    /// The one submap that is shown.
    pub(crate) submap: Option<u16>,
    /// Whether the view is being moved: then what is quick goes before what is fine.
    pub(crate) moving: bool,
}

impl Default for Wish {
    fn default() -> Self {
        Self { free: None, shading: Shading::Phong, max_depth_m: 8.0, submap: None, moving: false }
    }
}

/// What thread and window share.
struct Shared {
    state: Mutex<State>,
    wish: Mutex<Wish>,
    /// Set to end the thread after what it is at.
    end: AtomicBool,
    /// Tells the window that there is something new, and whether somebody waits for it.
    repaint: Box<dyn Fn(bool) + Send + Sync>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wish(&self) -> Wish {
        *self.wish.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes what the window knows, as was asked for, and has it drawn.
    fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let result = change(&mut self.state());
        (self.repaint)(true);
        result
    }

    /// The same for what goes on by itself: it is drawn when there is time.
    fn go_on<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let result = change(&mut self.state());
        (self.repaint)(false);
        result
    }
}

/// The thread, from the window's side. Dropping it ends the thread, once what was done so far is kept.
pub(crate) struct Engine {
    shared: Arc<Shared>,
    commands: Option<Sender<Command>>,
    thread: Option<JoinHandle<()>>,
}

impl Engine {
    /// Starts the thread. `repaint` is called when there is something new to see, and told whether somebody waits for it.
    pub(crate) fn start(
        device: &Device,
        keeper_for: Option<KeeperFor>,
        repaint: impl Fn(bool) + Send + Sync + 'static,
    ) -> Self {
        let (mut engine, commands) = Self::without_thread(repaint);
        let (device, shared) = (device.clone(), Arc::clone(&engine.shared));
        let thread = std::thread::Builder::new()
            .name("reconstruction".into())
            .spawn(move || work::Worker::new(device, shared, keeper_for).run(&commands));
        engine.thread = Some(thread.expect("the system starts a thread"));
        engine
    }

    /// One whose commands arrive at the caller's.
    pub(crate) fn without_thread(repaint: impl Fn(bool) + Send + Sync + 'static) -> (Self, Receiver<Command>) {
        let (sender, receiver) = mpsc::channel();
        let shared = Shared {
            state: Mutex::default(),
            wish: Mutex::default(),
            end: AtomicBool::new(false),
            repaint: Box::new(repaint),
        };
        (Self { shared: Arc::new(shared), commands: Some(sender), thread: None }, receiver)
    }

    /// What is known at the moment. The thread waits while this is held.
    pub(crate) fn state(&self) -> MutexGuard<'_, State> {
        self.shared.state()
    }

    /// Sends a command. Commands are carried out one after the other.
    pub(crate) fn send(&self, command: Command) {
        let Some(commands) = &self.commands else { return };
        if commands.send(command).is_err() {
            self.state().say(None, state::Kind::Error, "the reconstruction has ended unexpectedly; restart the viewer");
        }
    }

    /// Wishes for a view: the latest wish counts.
    pub(crate) fn wish(&self, wish: Wish) {
        let changed = {
            let mut held = self.shared.wish.lock().unwrap_or_else(PoisonError::into_inner);
            let changed = *held != wish;
            *held = wish;
            changed
        };
        if changed {
            self.send(Command::Look);
        }
    }

    /// Tells the thread to end, once what was reconstructed so far is kept. Whether it has.
    pub(crate) fn begin_end(&mut self) -> bool {
        self.shared.end.store(true, Ordering::Relaxed);
        self.commands = None;
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends the thread, and waits until what was reconstructed so far is kept.
    pub(crate) fn end(&mut self) {
        self.begin_end();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the reconstruction ended with a panic");
        }
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.end();
    }
}
