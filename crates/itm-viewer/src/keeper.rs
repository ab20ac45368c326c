//! Who keeps a reconstruction's results.

use std::path::PathBuf;

use itm_slam::{Event, Session};

/// Keeps the results of a reconstruction while it goes on, as a program that runs one without a window does.
pub trait Keeper: Send {
    /// Takes in an event, in the order in which they come.
    ///
    /// # Errors
    /// Where it cannot be written, in words. The reconstruction goes on, and this is not called again.
    fn event(&mut self, event: &Event, session: &mut Session) -> Result<(), String>;

    /// Writes what is written at the end, and returns where the results are. `event` has taken in [`Event::Finished`]. Called
    /// again where the recording was gone back in after its end: what was written before is replaced.
    ///
    /// # Errors
    /// Where something cannot be written, in words.
    fn finish(&mut self, session: &mut Session) -> Result<PathBuf, String>;
}

/// Makes a keeper for a reconstruction when its first frame is about to be processed, of the recording at a path; an error says
/// why nothing is kept.
pub type KeeperFor = Box<dyn FnMut(&std::path::Path, &mut Session) -> Result<Box<dyn Keeper>, String> + Send>;
