//! What is asked of a relocaliser, whatever its method.

use itm_core::{RelocaliserKind, Se3, Settings, Timestamp};

use crate::{Candidate, Error, Ferns, Harvest, Keyframe, SmallView};

/// Keeps keyframes, and finds those that look like a view.
///
/// The same calls in the same order give the same answers.
pub trait Relocaliser: Send {
    /// Offers the view of a well tracked frame with the camera's pose in a submap. It becomes a keyframe where it is dissimilar
    /// enough from all that there are of its place: in its submap and near it.
    ///
    /// # Errors
    /// A view of the wrong size or one made by [`SmallView::seen_from`], a pose that is no rigid motion, or no number left; nothing
    /// has changed then.
    fn harvest(
        &mut self,
        view: &SmallView,
        submap: u16,
        submap_from_camera: &Se3,
        timestamp: Timestamp,
    ) -> Result<Harvest, Error>;

    /// At most `count` keyframes that are most similar to a view, of those that `accept` is true for: the most similar first,
    /// and of equal ones that with the smaller number. Those without anything in common with the view are no candidates; none
    /// is where too little is seen (`relocaliser.min_valid_share`), or too little is known of a view from elsewhere
    /// ([`SmallView::seen_from`], `relocaliser.min_compared_share`) to compare it.
    ///
    /// # Errors
    /// A view of the wrong size.
    fn candidates(
        &self,
        view: &SmallView,
        count: usize,
        accept: &dyn Fn(&Keyframe) -> bool,
    ) -> Result<Vec<Candidate>, Error>;

    /// All keyframes, in the order of their numbers.
    fn keyframes(&self) -> &[Keyframe];

    /// The keyframe with a number, unless it was removed.
    fn keyframe(&self, id: u32) -> Option<&Keyframe> {
        let keyframes = self.keyframes();
        keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok().map(|at| &keyframes[at])
    }

    /// Sets where a keyframe's camera was in its submap.
    ///
    /// # Errors
    /// A number without a keyframe, or a pose that is no rigid motion.
    fn set_pose(&mut self, id: u32, submap_from_camera: &Se3) -> Result<(), Error>;

    /// Removes the keyframes of a submap, and says how many there were.
    fn remove_submap(&mut self, submap: u16) -> usize;

    /// The keyframes as bytes, with what their comparison depends on.
    fn save(&self) -> Vec<u8>;

    /// Takes saved keyframes in place of those that there are.
    ///
    /// # Errors
    /// Bytes that are damaged, of another version, or made with a setting that differs from this relocaliser's; the keyframes
    /// are as they were then.
    fn load(&mut self, saved: &[u8]) -> Result<(), Error>;
}

/// The relocaliser that the settings choose, without keyframes; none where they switch it off.
///
/// # Errors
/// Settings out of range.
pub fn new_relocaliser(settings: &Settings) -> Result<Option<Box<dyn Relocaliser>>, Error> {
    Ok(match settings.relocaliser.kind {
        RelocaliserKind::Off => None,
        RelocaliserKind::Ferns => Some(Box::new(Ferns::new(settings)?)),
    })
}
