//! Decoding on another thread.

use std::sync::mpsc::{self, Receiver};
use std::thread::{self, JoinHandle};

use itm_core::Frame;

use super::{Recording, RecordingInfo};
use crate::Error;

/// Reads a recording's frames on another thread, some frames ahead of who asks for them.
///
/// An iterator over the frames in the order asked for; a frame that cannot be read is an `Err` in its place, and the
/// next ones follow. Dropping it ends the thread after the frame that it is at.
///
/// ```no_run
/// use itm_io::recording::{self, OpenOptions, ReadAhead};
///
/// let recording = recording::open("rgbd_dataset_freiburg1_desk".as_ref(), &OpenOptions::default())?;
/// let frames = 0..recording.info().frames;
/// for frame in ReadAhead::new(recording, frames, ReadAhead::DEFAULT_FRAMES) {
///     match frame {
///         Ok(frame) => println!("frame {} was taken at {}", frame.index, frame.timestamp),
///         Err(error) => eprintln!("skipped: {error}"),
///     }
/// }
/// # Ok::<(), itm_io::Error>(())
/// ```
pub struct ReadAhead {
    info: RecordingInfo,
    /// `None` once the thread has ended or is being ended.
    frames: Option<Receiver<Result<Frame, Error>>>,
    /// Gives the recording back as it ends.
    thread: Option<JoinHandle<Box<dyn Recording>>>,
    /// The recording, once the thread has ended.
    ended: Option<Box<dyn Recording>>,
    ahead: usize,
}

impl ReadAhead {
    /// Frames decoded ahead unless there is a reason for another number.
    pub const DEFAULT_FRAMES: usize = 4;

    /// Starts to read frames by their numbers from 0, and to hold up to `ahead` of them ready.
    ///
    /// # Panics
    /// If the operating system cannot start a thread.
    pub fn new<I>(recording: Box<dyn Recording>, frames: I, ahead: usize) -> Self
    where
        I: IntoIterator<Item = usize>,
        I::IntoIter: Send + 'static,
    {
        let info = recording.info().clone();
        let mut reader = Self { info, frames: None, thread: None, ended: Some(recording), ahead };
        reader.restart(frames);
        reader
    }

    /// Goes on with other frames; those that were read ahead are forgotten. Waits for the one that is being read.
    ///
    /// # Panics
    /// If the operating system cannot start a thread, and with a panic of a decoder.
    pub fn restart<I>(&mut self, frames: I)
    where
        I: IntoIterator<Item = usize>,
        I::IntoIter: Send + 'static,
    {
        self.end();
        let mut recording = self.ended.take().expect("the thread gives it back");
        let (sender, receiver) = mpsc::sync_channel(self.ahead);
        let frames = frames.into_iter();
        let decode = move || {
            for index in frames {
                // Nobody listens any more once the receiver has been dropped.
                if sender.send(recording.read(index)).is_err() {
                    break;
                }
            }
            recording
        };
        let thread = thread::Builder::new().name("read-ahead".into()).spawn(decode);
        self.thread = Some(thread.expect("the system starts a thread"));
        self.frames = Some(receiver);
    }

    fn end(&mut self) {
        self.frames = None;
        if let Some(thread) = self.thread.take() {
            match thread.join() {
                Ok(recording) => self.ended = Some(recording),
                // A decoder's bug must not look like the end of the recording.
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
    }

    /// What is known of the recording.
    pub fn info(&self) -> &RecordingInfo {
        &self.info
    }
}

impl std::fmt::Debug for ReadAhead {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ReadAhead").field("recording", &self.info.name).finish_non_exhaustive()
    }
}

impl Iterator for ReadAhead {
    type Item = Result<Frame, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        let frame = self.frames.as_ref()?.recv().ok();
        if frame.is_none() {
            self.end();
        }
        frame
    }
}

impl Drop for ReadAhead {
    fn drop(&mut self) {
        self.frames = None;
        if let Some(thread) = self.thread.take() {
            // The frames were abandoned, so that a panic while decoding one has nobody to reach.
            let _: thread::Result<_> = thread.join();
        }
    }
}
