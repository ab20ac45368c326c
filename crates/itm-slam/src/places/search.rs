//! Finding a frame among places: at a glance, then in full.

use itm_core::{Frame, Se3};
use itm_reloc::{AveragePose, Candidate, average_pose};

use super::poses::{around_keyframe, is_near};
use super::proposals::{Place, Proposal, distinct};
use super::{Found, Places};
use crate::Error;
use crate::local::{Eyes, Local};
use crate::mapper::Mapper;
use crate::tracking::{Tracked, Verdict};

impl Places {
    /// Finds the frame near where keyframes were taken that it resembles.
    pub(crate) fn find_among(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        candidates: &[Candidate],
    ) -> Result<Option<Found>, Error> {
        let proposals: Vec<_> = candidates.iter().map(|candidate| Proposal::at(*candidate)).collect();
        self.find_from(mapper, eyes, frame, &proposals, candidates)
    }

    /// Finds the frame near one of several places, the likeliest first: the best of those that are confirmed. The mean pose of
    /// `candidates` is looked at as well where it is near one of them.
    pub(super) fn find_from(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        proposals: &[Proposal],
        candidates: &[Candidate],
    ) -> Result<Option<Found>, Error> {
        let mean = average_pose(candidates, &self.settings).filter(|mean| mean.candidates > 1);
        let mut places: Vec<Place> = Vec::new();
        // Until one is confirmed: most frames need no more than the first few.
        for together in proposals.chunks(self.settings.at_once as usize) {
            places.extend(self.glance_at(mapper, eyes, frame, together, mean.as_ref())?);
            places = distinct(places, &self.settings);
            if let Some(found) = self.confirm(mapper, eyes, frame, &mut places, 1)? {
                return Ok(Some(found));
            }
        }
        self.confirm(mapper, eyes, frame, &mut places, self.settings.followed_up as usize)
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
        look_from(&mut self.trial, mapper, submap, submap_from_camera)?;
        let tracked = self.trial.track_from(eyes, frame, &[*submap_from_camera])?.expect("there is a model");
        // Good frames are enough: where it is expected, and what follows, speak for it too.
        self.follow_up(mapper, eyes, frame, submap, tracked.estimate, 1.0)
    }

    /// Where coarse tracking leads from several proposals, at a glance; the best first.
    fn glance_at(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        proposals: &[Proposal],
        mean: Option<&AveragePose>,
    ) -> Result<Vec<Place>, Error> {
        let Self { glance, settings: own, .. } = self;
        let mut led = Vec::new();
        for Proposal { candidate, submap_from_camera: pose } in proposals {
            let submap = candidate.keyframe.submap;
            look_from(glance, mapper, submap, pose)?;
            let mut poses = around_keyframe(pose, own.reach_m, own.reach_rad);
            let mean = mean.filter(|mean| mean.submap == submap).map(|mean| mean.submap_from_camera);
            poses.extend(mean.filter(|mean| is_near(mean, pose, own.reach_m, own.reach_rad)));
            let best = glance.shortlist(eyes, frame, &poses, own.searched as usize)?;
            for (error, pose) in glance.refine(eyes, frame, &best)? {
                led.push(Place::new(error, Proposal { candidate: *candidate, submap_from_camera: pose }));
            }
        }
        let mut places = distinct(led, own);
        places.truncate(own.refined as usize);
        // Once more, with the map as seen from there.
        for place in &mut places {
            let Proposal { candidate, submap_from_camera: pose } = &mut place.proposal;
            look_from(glance, mapper, candidate.keyframe.submap, pose)?;
            if let Some(refined) = glance.refine(eyes, frame, &[*pose])?.pop() {
                (place.error, *pose) = refined;
            }
        }
        Ok(distinct(places, own))
    }

    /// Follows up at most so many of the best places, of those that were not yet: the best one that is confirmed, if any is.
    fn confirm(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        places: &mut [Place],
        most: usize,
    ) -> Result<Option<Found>, Error> {
        let (followed_up, rivals_within) = (self.settings.followed_up as usize, self.settings.rivals_within);
        let mut best: Option<(f64, Found)> = None;
        for (rank, place) in places.iter_mut().take(followed_up).enumerate() {
            // Once one is confirmed, those that fit about as well must be looked at too.
            let is_wanted = match &best {
                Some((error, _)) => place.error <= rivals_within * error,
                None => rank < most,
            };
            if place.followed_up || !is_wanted {
                continue;
            }
            place.followed_up = true;
            let Proposal { candidate, submap_from_camera } = place.proposal;
            let (submap, keyframe) = (candidate.keyframe.submap, candidate.keyframe.id);
            let most_wrong = self.settings.max_chance_wrong;
            let tracked = self.follow_up(mapper, eyes, frame, submap, submap_from_camera, most_wrong)?;
            let (error, found) = (place.error, tracked.is_some());
            tracing::debug!(submap, keyframe, rank, error, found, "a place is followed up");
            let Some(tracked) = tracked else { continue };
            if best.as_ref().is_none_or(|(_, best)| tracked.chance_wrong < best.tracked.chance_wrong) {
                best = Some((error, Found { candidate, tracked }));
            }
        }
        Ok(best.map(|(_, found)| found))
    }

    /// Tracks again from where tracking led, with the map as seen from there, until all that the frame shows agrees with it;
    /// `None` where it does not come to that.
    fn follow_up(
        &mut self,
        mapper: &mut Mapper,
        eyes: &mut Eyes<'_>,
        frame: &Frame,
        submap: u16,
        mut pose: Se3,
        max_chance_wrong: f64,
    ) -> Result<Option<Tracked>, Error> {
        let Self { trial, unlearnt, settings: own, .. } = self;
        // What was learnt at other places must not tell one try from another.
        trial.tracker.learn(unlearnt);
        let mut before = f64::INFINITY;
        for round in 0..own.rounds {
            look_from(trial, mapper, submap, &pose)?;
            let next = trial.track_from(eyes, frame, &[pose])?.expect("there is a model");
            let (verdict, share) = (next.verdict.name(), next.inlier_share);
            tracing::debug!(submap, round, verdict, next.chance_wrong, share, "a place is tried");
            let as_cast = is_near(&pose, &next.estimate, own.cast_within_m, own.cast_within_rad);
            if next.verdict == Verdict::Good && next.chance_wrong <= max_chance_wrong && as_cast {
                return Ok((next.inlier_share >= own.min_inlier_share).then_some(next));
            }
            if next.chance_wrong >= before {
                break;
            }
            (pose, before) = (next.estimate, next.chance_wrong);
        }
        Ok(None)
    }
}

/// Casts a submap as it is seen from a pose, to be tracked against.
fn look_from(local: &mut Local, mapper: &mut Mapper, submap: u16, submap_from_camera: &Se3) -> Result<(), Error> {
    mapper.cast_for_tracking(submap, &mut local.model, submap_from_camera)?;
    local.submap = submap;
    local.submap_from_model = Some(*submap_from_camera);
    Ok(())
}
