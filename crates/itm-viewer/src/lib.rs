//! The desktop viewer: a reconstruction while it runs, a saved map, or the results of a run, in a window.
//!
//! The window and the reconstruction share one graphics device: pictures of the map go from one to the other without passing
//! through the host. The reconstruction runs on a thread of its own (`engine`), takes commands and wishes, and says what
//! there is to see; the window never waits for it.

mod action;
mod app;
#[cfg(test)]
mod app_tests;
mod bars;
mod camera;
mod dialog;
mod engine;
mod keeper;
mod overlay;
mod pane;
mod plots;
mod run;
mod settings_panel;
mod sidebar;
mod textures;
mod theme;
mod toasts;

pub use keeper::{Keeper, KeeperFor};
pub use run::{Error, Options, run};
