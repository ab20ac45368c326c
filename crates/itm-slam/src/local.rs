//! Tracking within one submap: what the camera is compared with there, and what is known of its way.

use std::ops::Range;

use itm_core::{Calibration, Frame, Se3, Settings};
use itm_gpu::evaluate::Evaluator;
use itm_gpu::photometric::PointList;
use itm_gpu::{Device, RaycastImage, View};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::atlas::check_pose;
use crate::mapper::Model;
use crate::tracking::{Against, Age, CHECK_LEVELS, Learnt, ModelObjective, Moment, Motion, Tracked, Tracker};

/// Tracking within a submap. Poses are in the submap's frame.
#[derive(Debug)]
pub(crate) struct Local {
    pub(crate) submap: u16,
    pub(crate) tracker: Tracker,
    /// Surface points with the colours of the frame before and of the map, where the tracker compares them.
    pub(crate) lists: [Option<PointList>; 2],
    pub(crate) motion: Motion,
    pub(crate) age: Age,
    /// The submap as seen from the last pose.
    pub(crate) model: Model,
    pub(crate) submap_from_model: Option<Se3>,
    /// The last pose with a good verdict, to which tracking returns after a loss.
    pub(crate) last_good: Option<Se3>,
    /// Good frames still to come after a loss before frames are fused again.
    pub(crate) to_recover: u32,
}

/// A [`Local`]'s state on the host as it is saved.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct LocalState {
    pub(crate) submap: u16,
    fused_frames: u64,
    to_recover: u32,
    submap_from_model: Option<Se3>,
    last_good: Option<Se3>,
    full_cast: Option<(u32, [f64; 3])>,
    motion: Motion,
    learnt: Learnt,
}

impl LocalState {
    /// Whether the camera is known to be in the submap.
    pub(crate) fn is_tracked(&self) -> bool {
        self.submap_from_model.is_some()
    }

    /// Forgets where the camera was.
    pub(crate) fn forget(&mut self) {
        (self.submap_from_model, self.last_good) = (None, None);
        self.motion.forget();
    }

    /// Why no session can go on from it, where it was read back from a file.
    pub(crate) fn check(&self) -> Result<(), String> {
        let poses = self.submap_from_model.iter().chain(&self.last_good);
        let checked = poses.copied().chain(self.motion.last()).try_for_each(|pose| check_pose(&pose));
        checked.map_err(|reason| format!("the last pose in submap {} is none: {reason}", self.submap))
    }
}

/// What a frame is looked at with.
pub(crate) struct Eyes<'a> {
    pub(crate) evaluator: &'a mut Evaluator,
    pub(crate) view: &'a View,
    pub(crate) calibration: &'a Calibration,
    pub(crate) settings: &'a Settings,
}

impl Local {
    /// Nothing to track against yet.
    pub(crate) fn new(
        device: &Device,
        calibration: &Calibration,
        tracker: &Tracker,
        needs: &Needs,
        submap: u16,
    ) -> Result<Self, Error> {
        let image = RaycastImage::new(device, calibration.depth)?;
        let list = |range: &Option<Range<usize>>| {
            range.as_ref().map(|range| PointList::spaced(device, &image, range.start, range.end, needs.every))
        };
        Ok(Self {
            submap,
            tracker: tracker.clone(),
            lists: needs.lists.each_ref().map(list),
            motion: Motion::default(),
            age: Age::default(),
            model: Model::new(image),
            submap_from_model: None,
            last_good: None,
            to_recover: 0,
        })
    }

    /// Finds a frame's pose, starting from where the camera's motion leads and from further poses. `None` without a model.
    pub(crate) fn track(
        &mut self,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        further: &[Se3],
    ) -> Result<Option<Tracked>, Error> {
        self.track_with(eyes, frame, |tracker, objective, moment| tracker.track(objective, moment, further))
    }

    /// The most promising of several poses; see [`Tracker::shortlist`]. None without a model.
    pub(crate) fn shortlist(
        &mut self,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        poses: &[Se3],
        most: usize,
    ) -> Result<Vec<Se3>, Error> {
        let best = self.track_with(eyes, frame, |tracker, objective, moment| {
            tracker.shortlist(objective, moment.age, poses, most)
        })?;
        Ok(best.unwrap_or_default())
    }

    /// Where several poses lead; see [`Tracker::refine`]. Nowhere without a model.
    pub(crate) fn refine(
        &mut self,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        starts: &[Se3],
    ) -> Result<Vec<(f64, Se3)>, Error> {
        let refined =
            self.track_with(eyes, frame, |tracker, objective, moment| tracker.refine(objective, moment.age, starts))?;
        Ok(refined.unwrap_or_default())
    }

    /// Finds a frame's pose, starting from certain poses. `None` without a model.
    pub(crate) fn track_from(
        &mut self,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        starts: &[Se3],
    ) -> Result<Option<Tracked>, Error> {
        self.track_with(eyes, frame, |tracker, objective, moment| tracker.track_from(objective, moment, starts))
    }

    fn track_with<T>(
        &mut self,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        track: impl FnOnce(&mut Tracker, &mut ModelObjective<'_>, &Moment<'_>) -> Result<T, Error>,
    ) -> Result<Option<T>, Error> {
        let Some(world_from_model) = self.submap_from_model else { return Ok(None) };
        let mut objective = ModelObjective {
            evaluator: eyes.evaluator,
            view: eyes.view,
            model: &self.model.image,
            lists: self.lists.each_ref().map(Option::as_ref),
            world_from_model,
            before: self.motion.last(),
            colour_lead: self.motion.colour_lead(frame, &eyes.settings.view),
            depth_from_colour: eyes.calibration.colour_from_depth.inverse(),
        };
        let moment = Moment { frame, motion: &self.motion, age: self.age, in_doubt: self.to_recover > 0 };
        track(&mut self.tracker, &mut objective, &moment).map(Some)
    }

    /// The list that colours of the frame before, or of the map, are in.
    pub(crate) fn list(&self, against: Against) -> Option<&PointList> {
        self.lists[against as usize].as_ref()
    }

    pub(crate) fn state(&self) -> LocalState {
        LocalState {
            submap: self.submap,
            fused_frames: self.age.frames,
            to_recover: self.to_recover,
            submap_from_model: self.submap_from_model,
            last_good: self.last_good,
            full_cast: self.model.full_cast.map(|(frames, centre)| (frames, centre.to_array())),
            motion: self.motion.clone(),
            learnt: self.tracker.learnt(),
        }
    }

    pub(crate) fn set_state(&mut self, state: LocalState) {
        self.submap = state.submap;
        self.age.frames = state.fused_frames;
        self.to_recover = state.to_recover;
        self.submap_from_model = state.submap_from_model;
        self.last_good = state.last_good;
        self.model.full_cast = state.full_cast.map(|(frames, centre)| (frames, centre.into()));
        self.motion = state.motion;
        self.tracker.learn(&state.learnt);
    }
}

/// What a tracker's plans need of a view and of the model.
#[derive(Clone, Debug)]
pub(crate) struct Needs {
    /// Levels of the depth pyramid.
    pub(crate) levels: usize,
    /// Levels of the point lists, by [`Against`].
    pub(crate) lists: [Option<Range<usize>>; 2],
    /// Of their points only every so many along both axes.
    pub(crate) every: u32,
}

impl Needs {
    /// Where poses are given.
    pub(crate) fn nothing() -> Self {
        Self { levels: 1, lists: [None, None], every: 1 }
    }

    pub(crate) fn of(tracker: &Tracker) -> Self {
        let mut needs = Self { levels: CHECK_LEVELS, lists: [None, None], every: tracker.every_point() };
        for level in tracker.plans(Age::default()).iter().flat_map(|plan| &plan.levels) {
            needs.levels = needs.levels.max(level.request.level + 1);
            for (range, term) in needs.lists.iter_mut().zip(&level.request.colour) {
                let Some(term) = term else { continue };
                let known = range.get_or_insert(term.level..term.level + 1);
                *known = known.start.min(term.level)..known.end.max(term.level + 1);
            }
        }
        needs
    }
}
