//! Places that the camera has been at, and finding it there again (the report, on the random ferns relocaliser; Glocker et al.
//! 2015, *Real-Time RGB-D Camera Relocalization via Randomized Ferns for Keyframe Encoding*).
//!
//! A keyframe only says what a view resembles. From its pose, and from others around it, the frame is tracked against the map
//! as seen from there; then once more against the map as seen from where that led, so that the whole image is compared. That
//! finds poses between the keyframes, and refuses a place that only looks alike.

use itm_core::{Frame, RelocaliserImage, Se3, Settings, Timestamp, TrackerKind};
use itm_gpu::shrink::{Shrink, SmallReader};
use itm_gpu::{Device, Recorder, View};
use itm_reloc::{Candidate, Harvest, Keyframe, Relocaliser, SmallView, new_relocaliser};

use crate::Error;
use crate::happening::Happening;
use crate::local::{Eyes, Local, Needs};
use crate::mapper::Mapper;
use crate::tracking::{Learnt, Tracked, Tracker, Verdict};

/// Poses around a keyframe's from which tracking sets out, of all that are compared at the coarsest level.
const SEARCHED: usize = 4;
/// Places that are followed up, of those that the candidates lead to, and how often.
const FOLLOWED_UP: usize = 3;
const ROUNDS: usize = 4;

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
    candidates: usize,
    min_inlier_share: f64,
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
    /// None yet; `None` where the settings switch it off.
    pub(crate) fn new(
        device: &Device,
        calibration: &itm_core::Calibration,
        settings: &Settings,
    ) -> Result<Option<Self>, Error> {
        let Some(relocaliser) = new_relocaliser(settings)? else { return Ok(None) };
        let own = &settings.relocaliser;
        let tracker = Tracker::new(&trial_settings(settings), &calibration.depth)?;
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
            trial: Local::new(device, calibration, &tracker, &Needs::nothing(), 0)?,
            candidates: own.candidates as usize,
            min_inlier_share: own.min_inlier_share,
        }))
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

    /// The current frame's view. Waits for `view` alone where nothing was recorded since.
    fn view(&mut self, device: &Device) -> Result<Option<&SmallView>, Error> {
        if let Some(reader) = self.reader.take() {
            let (depth, colour) = reader.read(device)?;
            self.view = Some(SmallView::new(depth, colour)?);
        }
        Ok(self.view.as_ref())
    }

    /// Remembers the current frame's view, if it resembles none of those remembered.
    pub(crate) fn remember(
        &mut self,
        device: &Device,
        submap: u16,
        submap_from_camera: &Se3,
        timestamp: Timestamp,
    ) -> Result<Option<Happening>, Error> {
        if self.view(device)?.is_none() {
            return Ok(None);
        }
        let Some(view) = &self.view else { return Ok(None) };
        Ok(match self.relocaliser.harvest(view, submap, submap_from_camera, timestamp)? {
            Harvest::Added { id, .. } => Some(Happening::Keyframe { id, submap }),
            Harvest::Known { .. } | Harvest::Blind { .. } => None,
        })
    }

    /// Keyframes that the current frame's view resembles, the most similar first.
    pub(crate) fn candidates(
        &mut self,
        device: &Device,
        accept: &dyn Fn(&Keyframe) -> bool,
    ) -> Result<Vec<Candidate>, Error> {
        let count = self.candidates;
        if self.view(device)?.is_none() {
            return Ok(Vec::new());
        }
        let Some(view) = &self.view else { return Ok(Vec::new()) };
        Ok(self.relocaliser.candidates(view, count, accept)?)
    }

    /// Finds the frame among the keyframes that it resembles: the best of them by the verdict of tracking.
    pub(crate) fn find(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        candidates: &[Candidate],
    ) -> Result<Option<Found>, Error> {
        // What was learnt at other places must not tell one try from another.
        self.trial.tracker.learn(&self.unlearnt);
        let mut led = Vec::new();
        for candidate in candidates {
            let pose = candidate.keyframe.submap_from_camera;
            self.look_from(mapper, candidate.keyframe.submap, &pose)?;
            let tracked = self.trial.search(eyes, frame, &near(&pose), SEARCHED)?.expect("there is a model");
            led.push((*candidate, tracked));
        }
        led.sort_by(|(_, a), (_, b)| a.chance_wrong.total_cmp(&b.chance_wrong));
        let mut best: Option<Found> = None;
        for (candidate, tracked) in led.into_iter().take(FOLLOWED_UP) {
            let submap = candidate.keyframe.submap;
            let Some(tracked) = self.follow_up(mapper, eyes, frame, submap, tracked)? else { continue };
            if best.as_ref().is_none_or(|best| tracked.chance_wrong < best.tracked.chance_wrong) {
                best = Some(Found { candidate, tracked });
            }
        }
        Ok(best)
    }

    /// Finds the frame in a submap near where it is expected.
    pub(crate) fn find_near(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        submap: u16,
        submap_from_camera: &Se3,
    ) -> Result<Option<Tracked>, Error> {
        self.trial.tracker.learn(&self.unlearnt);
        self.look_from(mapper, submap, submap_from_camera)?;
        let tracked = self.trial.track_from(eyes, frame, &[*submap_from_camera])?.expect("there is a model");
        self.follow_up(mapper, eyes, frame, submap, tracked)
    }

    /// Tracks again from where tracking led, with the map as seen from there, until all that the frame shows agrees with it;
    /// `None` where it does not come to that.
    fn follow_up(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        submap: u16,
        mut tracked: Tracked,
    ) -> Result<Option<Tracked>, Error> {
        for round in 0..ROUNDS {
            let pose = tracked.estimate;
            self.look_from(mapper, submap, &pose)?;
            let next = self.trial.track_from(eyes, frame, &[pose])?.expect("there is a model");
            let (verdict, share) = (next.verdict.name(), next.inlier_share);
            tracing::debug!(submap, round, verdict, next.chance_wrong, share, "a place is tried");
            if next.verdict == Verdict::Good {
                return Ok((next.inlier_share >= self.min_inlier_share).then_some(next));
            }
            if round > 0 && next.chance_wrong >= tracked.chance_wrong {
                break;
            }
            tracked = next;
        }
        Ok(None)
    }

    /// Casts a submap as it is seen from a pose, to be tracked against.
    fn look_from(&mut self, mapper: &mut Mapper, submap: u16, submap_from_camera: &Se3) -> Result<(), Error> {
        mapper.cast_for_tracking(submap, &mut self.trial.model, submap_from_camera)?;
        self.trial.submap = submap;
        self.trial.submap_from_model = Some(*submap_from_camera);
        Ok(())
    }
}

/// Of depth alone: a candidate's place has no frame before whose colours could be compared.
fn trial_settings(settings: &Settings) -> Settings {
    let mut settings = settings.clone();
    settings.tracker.kind = TrackerKind::Extended;
    settings.tracker.extended.use_depth = true;
    settings.tracker.extended.use_colour = false;
    settings.tracker.extended.use_map_colour = false;
    // From further away than between frames, and not turning alone.
    settings.tracker.extended.levels = "bbbb".into();
    settings.tracker.extended.max_plane_distance_coarse_m = 0.3;
    settings
}

/// Poses around a keyframe's: it, and others as far as most of its view is still in view.
fn near(pose: &Se3) -> Vec<Se3> {
    let mut poses = Vec::new();
    for degrees in [0.0_f64, 12.0, -12.0, 24.0, -24.0] {
        for [x, z] in [[0.0, 0.0], [0.3, 0.0], [-0.3, 0.0], [0.0, 0.3], [0.0, -0.3], [0.0, 0.6], [0.0, -0.6]] {
            poses.push(
                *pose
                    * Se3::exp([x, 0.0, z, 0.0, 0.0, 0.0])
                    * Se3::exp([0.0, 0.0, 0.0, 0.0, degrees.to_radians(), 0.0]),
            );
        }
    }
    for degrees in [10.0_f64, -10.0] {
        poses.push(*pose * Se3::exp([0.0, 0.0, 0.0, degrees.to_radians(), 0.0, 0.0]));
        poses.push(*pose * Se3::exp([0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * degrees.to_radians()]));
    }
    poses
}

/// Poses around one, to start from after a loss: turned as far as an image still overlaps, or moved aside while turning.
pub(crate) fn around(pose: &Se3) -> Vec<Se3> {
    let mut poses = Vec::new();
    for degrees in [8.0_f64, -8.0, 16.0, -16.0] {
        let angle = degrees.to_radians();
        poses.push(*pose * Se3::exp([0.0, 0.0, 0.0, angle, 0.0, 0.0]));
        for aside_m in [-0.15, 0.0, 0.15] {
            poses.push(*pose * Se3::exp([aside_m, 0.0, 0.0, 0.0, angle, 0.0]));
        }
    }
    poses
}
