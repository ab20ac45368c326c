//! A session beside a camera's own loop: frames are pushed, and a thread processes them.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use itm_core::Frame;

use crate::{Error, FrameResult, Slam};

/// What is done with a frame that comes while another one still waits to be processed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenLate {
    /// The one that waits is dropped, and counted: the camera is never held up, and what is processed is always the latest frame.
    #[default]
    Drop,
    /// [`CameraLoop::push`] waits until there is room: every frame is processed, as fast as that goes.
    Wait,
}

/// Processes frames on a thread of its own, one after the other, while a camera's loop goes on.
///
/// ```no_run
/// # use itm_slam::{CameraLoop, Frame, Slam, WhenLate};
/// # fn camera() -> Vec<Frame> { Vec::new() }
/// # fn run(slam: Slam) -> Result<(), itm_slam::Error> {
/// let running = CameraLoop::start(slam, WhenLate::Drop);
/// for frame in camera() {
///     running.push(frame);
///     for result in running.results().try_iter() {
///         println!("{:?}", result?.world_from_camera);
///     }
/// }
/// let mut slam = running.stop();
/// # slam.finish()?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct CameraLoop {
    slot: Arc<Slot>,
    results: Receiver<Result<FrameResult, Error>>,
    /// There until it is stopped.
    thread: Option<JoinHandle<Slam>>,
    when_late: WhenLate,
}

/// Ends a [`CameraLoop`] from any thread.
#[derive(Clone, Debug)]
pub struct Stopper(Arc<Slot>);

impl Stopper {
    /// No further frame is processed, and none is waited for. The frame that is being processed still is.
    pub fn stop(&self) {
        self.0.end(true);
    }
}

/// The one frame that waits.
#[derive(Debug, Default)]
struct Slot {
    waiting: Mutex<Waiting>,
    changed: Condvar,
    dropped: AtomicU64,
}

#[derive(Debug, Default)]
struct Waiting {
    frame: Option<Frame>,
    /// No further frame comes.
    ended: bool,
}

impl Slot {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        // What is guarded is whole at any time.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self, without_waiting: bool) {
        let mut waiting = self.lock();
        waiting.ended = true;
        if without_waiting && waiting.frame.take().is_some() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        drop(waiting);
        self.changed.notify_all();
    }

    /// The next frame; none once no further one comes.
    fn take(&self) -> Option<Frame> {
        let waiting = self.lock();
        let mut waiting = self
            .changed
            .wait_while(waiting, |waiting| waiting.frame.is_none() && !waiting.ended)
            .unwrap_or_else(PoisonError::into_inner);
        let frame = waiting.frame.take();
        drop(waiting);
        self.changed.notify_all();
        frame
    }
}

/// Ends the slot when the thread is done, however it ends, so that nobody waits for it.
struct EndsWith(Arc<Slot>);

impl Drop for EndsWith {
    fn drop(&mut self) {
        self.0.end(true);
    }
}

impl CameraLoop {
    /// Starts the thread.
    #[must_use = "dropping it ends it"]
    pub fn start(slam: Slam, when_late: WhenLate) -> Self {
        let slot = Arc::new(Slot::default());
        let (sender, results) = channel();
        let of_thread = EndsWith(Arc::clone(&slot));
        let thread = std::thread::spawn(move || run(slam, &of_thread.0, &sender));
        Self { slot, results, thread: Some(thread), when_late }
    }

    /// Hands a frame over. Whether it was taken: after [`Stopper::stop`], or once the device has failed, it is not; the last of
    /// [`CameraLoop::results`] says why.
    pub fn push(&self, frame: Frame) -> bool {
        let mut waiting = self.slot.lock();
        if self.when_late == WhenLate::Wait {
            waiting = self
                .slot
                .changed
                .wait_while(waiting, |waiting| waiting.frame.is_some() && !waiting.ended)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if waiting.ended {
            return false;
        }
        if waiting.frame.replace(frame).is_some() {
            self.slot.dropped.fetch_add(1, Ordering::Relaxed);
        }
        drop(waiting);
        self.slot.changed.notify_all();
        true
    }

    /// What became of the frames, in their order. A frame whose images have another size than the calibration's is an error, and
    /// the next one is gone on with; any other error is the last.
    pub fn results(&self) -> &Receiver<Result<FrameResult, Error>> {
        &self.results
    }

    /// Frames that were handed over and never processed.
    pub fn dropped(&self) -> u64 {
        self.slot.dropped.load(Ordering::Relaxed)
    }

    /// What ends it from another thread.
    pub fn stopper(&self) -> Stopper {
        Stopper(Arc::clone(&self.slot))
    }

    /// Waits for the frames that were taken, and gives the session back with what was done so far, whatever failed.
    pub fn stop(mut self) -> Slam {
        self.slot.end(false);
        let thread = self.thread.take().expect("it is stopped once, by value");
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

/// Without [`CameraLoop::stop`] the frame that waits is not processed, and the session is gone once the thread has ended: it is
/// waited for.
impl Drop for CameraLoop {
    fn drop(&mut self) {
        self.slot.end(true);
        if let Some(thread) = self.thread.take() {
            // Where it panicked, that was said as it did.
            let _panicked = thread.join();
        }
    }
}

fn run(mut slam: Slam, slot: &Slot, results: &Sender<Result<FrameResult, Error>>) -> Slam {
    while let Some(frame) = slot.take() {
        let result = slam.process(&frame);
        let goes_on = matches!(&result, Ok(_) | Err(Error::Gpu(itm_gpu::Error::ImageSize { .. })));
        // Whoever does not ask for results need not hear of them.
        let _unheard = results.send(result);
        if !goes_on {
            break;
        }
    }
    slam
}
