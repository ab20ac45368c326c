//! Places that the camera has been at, and finding it there again (the report, on the random ferns relocaliser; Glocker et al.
//! 2015, *Real-Time RGB-D Camera Relocalization via Randomized Ferns for Keyframe Encoding*).
//!
//! A keyframe only says what a view resembles. The frame may be of a place that no keyframe is near to, so it is also compared
//! as it would look from further ahead, from further back, from the sides and turned ([`SmallView::seen_from`]); each
//! similar keyframe then says where the camera is. Poses around there are compared at a glance: coarsely, with the map in a
//! small image that shows more than the camera sees. From the best of them coarse tracking leads to a few poses, where the
//! frame is tracked in full, against the map as seen from there, until the whole image agrees. That finds poses between
//! and beside the keyframes, and refuses a place that only looks alike.

mod looks;
mod poses;
mod proposals;
mod search;

use itm_core::{Frame, Intrinsics, RelocaliserImage, RelocaliserSettings, Se3, Settings, Timestamp};
use itm_gpu::shrink::{Shrink, SmallReader};
use itm_gpu::{BlockMap, Device, RaycastImage, Recorder, View};
use itm_reloc::{Candidate, Harvest, Keyframe, Relocaliser, SmallView, new_relocaliser};

use crate::Error;
use crate::happening::Happening;
use crate::local::{Eyes, Local, Needs};
use crate::mapper::{Mapper, Model};
use crate::tracking::{Learnt, Tracked, Tracker};
use looks::{glance_settings, trial_level, trial_settings, wide};
use poses::moves;
use proposals::{Proposal, apart};

pub(crate) use poses::around;

/// The places, and what finds them.
pub(crate) struct Places {
    pub(crate) relocaliser: Box<dyn Relocaliser>,
    shrink: Shrink,
    reader: Option<SmallReader>,
    /// The current frame's view.
    view: Option<SmallView>,
    /// Tracking from a candidate's pose, and what it has learnt before any.
    trial: Local,
    unlearnt: Learnt,
    /// The same at a glance: coarse, and of more than is in view.
    glance: Local,
    /// The depth camera.
    camera: Intrinsics,
    settings: RelocaliserSettings,
}

impl std::fmt::Debug for Places {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Places").field("keyframes", &self.relocaliser.keyframes().len()).finish_non_exhaustive()
    }
}

/// Where a frame was found.
#[derive(Clone, Debug)]
pub(crate) struct Found {
    pub(crate) candidate: Candidate,
    /// In the candidate's submap.
    pub(crate) tracked: Tracked,
}

impl Found {
    pub(crate) fn happening(&self) -> Happening {
        let Candidate { keyframe: Keyframe { id, submap, .. }, dissimilarity } = self.candidate;
        Happening::Relocalised { keyframe: id, submap, dissimilarity }
    }
}

impl Places {
    /// No places yet; `None` where the settings switch it off. `map` is that which views are cast from.
    pub(crate) fn new(
        device: &Device,
        calibration: &itm_core::Calibration,
        settings: &Settings,
        map: &BlockMap,
    ) -> Result<Option<Self>, Error> {
        let Some(relocaliser) = new_relocaliser(settings)? else { return Ok(None) };
        let own = &settings.relocaliser;
        let finest = trial_level(&calibration.depth, own.trial_width);
        let tracker = Tracker::new(&trial_settings(settings, finest), &calibration.depth)?;
        let glancing = Tracker::new(&glance_settings(settings), &calibration.depth)?;
        let mut trial = Local::new(device, calibration, &tracker, &Needs::nothing(), 0)?;
        trial.model = Model::new(RaycastImage::new(device, calibration.depth.at_level(finest))?);
        let mut glance = Local::new(device, calibration, &glancing, &Needs::nothing(), 0)?;
        // Less wide where the device could not index the blocks in view.
        let margin_m = settings.map.truncation_m.max(settings.map.swap_margin_m);
        let fits = |camera: &Intrinsics| map.check_view(camera, settings.view.max_depth_m, margin_m).is_ok();
        let widenings = [own.widening, 0.5 * (1.0 + own.widening), 1.0];
        let cameras = widenings.map(|widening| wide(&calibration.depth, own.glance_width, widening));
        let camera = cameras.iter().find(|camera| fits(camera)).unwrap_or(&cameras[2]);
        glance.model = Model::new(RaycastImage::new(device, *camera)?);
        Ok(Some(Self {
            relocaliser,
            shrink: Shrink::new(
                device,
                (own.width, own.height),
                own.smoothing_px,
                own.image != RelocaliserImage::Depth,
            ),
            reader: None,
            view: None,
            unlearnt: tracker.learnt(),
            trial,
            glance,
            camera: calibration.depth,
            settings: own.clone(),
        }))
    }

    /// Takes over how places are looked for. How keyframes are chosen and coded, and the images that the map is cast into, stay.
    pub(crate) fn change_settings(&mut self, settings: &Settings) {
        let finest = trial_level(&self.camera, settings.relocaliser.trial_width);
        self.trial.tracker.change_settings(&trial_settings(settings, finest));
        self.glance.tracker.change_settings(&glance_settings(settings));
        self.settings = settings.relocaliser.clone();
    }

    /// What trials need of a view.
    pub(crate) fn needs(&self) -> Needs {
        Needs::of(&self.trial.tracker)
    }

    /// Records what a frame's view is to be compared by.
    pub(crate) fn look(&mut self, recorder: &mut Recorder, view: &View) {
        self.reader = Some(self.shrink.record(recorder, view));
        self.view = None;
    }

    /// Reads the current frame's view. Waits for `view` alone where nothing was recorded since.
    fn read_view(&mut self, device: &Device) -> Result<(), Error> {
        if let Some(reader) = self.reader.take() {
            let (depth, colour) = reader.read(device)?;
            self.view = Some(SmallView::new(depth, colour)?);
        }
        Ok(())
    }

    /// Remembers the current frame's view, if it resembles none of those remembered.
    pub(crate) fn remember(
        &mut self,
        device: &Device,
        submap: u16,
        submap_from_camera: &Se3,
        timestamp: Timestamp,
    ) -> Result<Option<Happening>, Error> {
        self.read_view(device)?;
        let Some(view) = &self.view else { return Ok(None) };
        Ok(match self.relocaliser.harvest(view, submap, submap_from_camera, timestamp)? {
            Harvest::Added { id, .. } => Some(Happening::Keyframe { id, submap }),
            Harvest::Known { .. } | Harvest::Blind { .. } => None,
        })
    }

    /// Keyframes that the current frame's view resembles as it is, the most similar first.
    pub(crate) fn candidates(
        &mut self,
        device: &Device,
        accept: &dyn Fn(&Keyframe) -> bool,
    ) -> Result<Vec<Candidate>, Error> {
        self.read_view(device)?;
        let Some(view) = &self.view else { return Ok(Vec::new()) };
        Ok(self.relocaliser.candidates(view, self.settings.candidates as usize, accept)?)
    }

    /// Places where the current frame may have been taken, the likeliest first, of which no two are near each other: poses from which
    /// keyframes would look as the frame does from there or from near there.
    fn proposals(&mut self, device: &Device) -> Result<Vec<Proposal>, Error> {
        self.read_view(device)?;
        let (Some(view), own) = (&self.view, &self.settings) else { return Ok(Vec::new()) };
        // Neighbours of those that are kept are left out.
        let count = 4 * own.candidates as usize;
        // The view as it is first: of equally similar ones the first is kept.
        let as_it_is = self.relocaliser.candidates(view, count, &|_| true)?;
        let mut all: Vec<Proposal> = as_it_is.into_iter().map(Proposal::at).collect();
        for view_from_moved in moves(own.reach_m, own.reach_rad) {
            let moved = view.seen_from(&self.camera, &view_from_moved);
            let found = self.relocaliser.candidates(&moved, count, &|_| true)?;
            all.extend(found.into_iter().map(|candidate| Proposal::seen_from(candidate, &view_from_moved)));
        }
        Ok(apart(all, own))
    }

    /// Finds the frame wherever it may be, and beside that the keyframes that it resembles, the most similar first.
    pub(crate) fn find_anywhere(
        &mut self,
        device: &Device,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
    ) -> Result<(Vec<Candidate>, Option<Found>), Error> {
        let candidates = self.candidates(device, &|_| true)?;
        let proposals = self.proposals(device)?;
        let found = self.find_from(mapper, eyes, frame, &proposals, &candidates)?;
        Ok((candidates, found))
    }
}
