//! Finding a camera's place again among keyframes, after a loss of tracking or to close a loop, for itm.
//!
//! A [`Relocaliser`] keeps keyframes: what the camera saw from a place, as a [`SmallView`], in a form that can be compared
//! quickly, and the camera's pose there. It harvests them while tracking is good, and says later which of them look like
//! a view. It cannot tell whether the place is the same: that is for tracking to confirm from the poses it proposes.
//!
//! [`Ferns`] is the one that there is: random ferns as in Glocker et al. 2015, *Real-Time RGB-D Camera Relocalization via
//! Randomized Ferns for Keyframe Encoding*, which Kähler et al. 2016, *Real-Time Large-Scale Dense 3D Reconstruction with Loop
//! Closure*, find loops between submaps with.
//!
//! Nothing here knows of a GPU, opens a file or starts a thread.
//!
//! ```
//! use itm_core::{Image, Se3, Settings, Timestamp};
//! use itm_reloc::{Ferns, Harvest, Relocaliser, SmallView};
//!
//! let mut relocaliser = Ferns::new(&Settings::default())?;
//! let depth = Image::from_fn(40, 30, |x, y| 1.0 + 0.02 * x as f32 + 0.03 * y as f32);
//! let view = SmallView::new(depth, None)?;
//! let harvest = relocaliser.harvest(&view, 0, &Se3::IDENTITY, Timestamp(0))?;
//! assert!(matches!(harvest, Harvest::Added { .. }));
//!
//! let candidates = relocaliser.candidates(&view, 5, &|_| true)?;
//! assert_eq!((candidates[0].keyframe.submap, candidates[0].dissimilarity), (0, 0.0));
//! # Ok::<(), itm_reloc::Error>(())
//! ```

mod average;
mod error;
mod ferns;
mod keyframe;
mod relocaliser;
mod view;

pub use average::{AveragePose, average_pose};
pub use error::{Difference, Error};
pub use ferns::Ferns;
pub use keyframe::{Candidate, Harvest, Keyframe};
pub use relocaliser::{Relocaliser, new_relocaliser};
pub use view::SmallView;
