//! The life of submaps (the report, on globally-consistent reconstruction; Kähler et al. 2016, *Real-Time Large-Scale Dense 3D
//! Reconstruction with Loop Closure*): the camera is tracked in all that are active, frames are fused into one of them, a new
//! one begins where the camera leaves its middle, and passive ones become active again where the camera comes back.

use itm_core::{Frame, MapIndex, Se3};
use itm_io::map_file::SubmapState;
use itm_reloc::Keyframe;
use serde::{Deserialize, Serialize};

use crate::atlas::{Atlas, PoseIn, Submap, SubmapLink, sees};
use crate::happening::Happening;
use crate::link::{Link, Observation};
use crate::local::{Eyes, Local};
use crate::places::Found;
use crate::tracking::{Tracked, Verdict};
use crate::{Error, Slam};

/// An active submap beside the primary, or one on trial.
#[derive(Debug)]
pub(crate) struct Beside {
    pub(crate) local: Local,
    pub(crate) life: Life,
}

/// How an active submap has fared.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Life {
    /// Frames in a row in which tracking was not good.
    failed: u32,
    /// Where it is not sure yet that the camera is there.
    trial: Option<Trial>,
}

impl Life {
    /// Whether the camera is tracked in the submap for good.
    pub(crate) fn is_settled(&self) -> bool {
        self.trial.is_none()
    }

    /// Why no session with so many submaps can use it for one of them, where it was read back from a file.
    pub(crate) fn check(&self, submap: u16, submaps: usize) -> Result<(), String> {
        let Some(Trial { link, from, .. }) = &self.trial else { return Ok(()) };
        link.check(submaps)?;
        let on_trial = Trial::link(*from, submap).key() == link.key();
        if on_trial { Ok(()) } else { Err(format!("what is on trial lies between {} and {}", link.from, link.to)) }
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Trial {
    tries: u32,
    successes: u32,
    /// The primary when it began.
    from: u16,
    link: Link,
}

impl Trial {
    /// Of the submap that the camera may be back in, measured from the primary.
    fn begin(from: u16, submap: u16) -> Self {
        Self { tries: 0, successes: 0, from, link: Self::link(from, submap) }
    }

    /// What it is to measure.
    fn link(from: u16, submap: u16) -> Link {
        Link::new([from.min(submap), from.max(submap)], true)
    }
}

/// What a frame says of an active submap.
struct Seen {
    pose: Se3,
    good: bool,
    /// Of the frame's pixels those that agree with the submap.
    share: f64,
}

impl Seen {
    fn in_submap(&self, submap: u16) -> PoseIn {
        PoseIn { submap, submap_from_camera: self.pose, weight: self.share }
    }
}

impl Slam {
    /// The submaps, by number; none with `mode = "basic"`.
    pub fn submaps(&self) -> &[Submap] {
        self.atlas.as_ref().map_or(&[], |atlas| &atlas.submaps)
    }

    /// The poses between submaps that were measured.
    pub fn submap_links(&self) -> Vec<SubmapLink> {
        self.atlas.iter().flat_map(Atlas::links).collect()
    }

    /// Where each submap lies in the world; the world is the only one's frame with `mode = "basic"`.
    pub(crate) fn submap_poses(&self) -> Vec<(u16, Se3)> {
        match &self.atlas {
            Some(atlas) => (0..).zip(&atlas.submaps).map(|(number, s)| (number, s.world_from_submap)).collect(),
            None => vec![(0, Se3::IDENTITY)],
        }
    }

    /// A pose in the primary submap as one in the world.
    pub(crate) fn to_world(&self, submap_from_camera: &Se3) -> Se3 {
        match &self.atlas {
            Some(atlas) => atlas.world_from(self.primary.submap) * *submap_from_camera,
            None => *submap_from_camera,
        }
    }

    /// A pose in the world as one in the primary submap.
    pub(crate) fn to_primary(&self, world_from_camera: &Se3) -> Se3 {
        match &self.atlas {
            Some(atlas) => atlas.world_from(self.primary.submap).inverse() * *world_from_camera,
            None => *world_from_camera,
        }
    }

    /// Follows the camera in the submaps beside the primary, once its pose there is known; decides which is the primary from
    /// here on. `before` is the last frame's pose. Returns the frame's pose in what is the primary now.
    pub(crate) fn tend(
        &mut self,
        frame: &Frame,
        before: Option<Se3>,
        pose: Se3,
        tracked: Option<&Tracked>,
        happenings: &mut Vec<Happening>,
    ) -> Result<Se3, Error> {
        let good = tracked.is_some_and(|tracked| tracked.verdict == Verdict::Good) && self.primary.to_recover == 0;
        let step = before.map(|before| before.inverse() * pose);
        let mut seen = self.track_beside(frame, step, good.then_some((&pose, tracked)), happenings)?;
        self.end_trials(&pose, &mut seen, happenings);
        let mut primary = Seen { pose, good, share: tracked.map_or(1.0, |tracked| tracked.inlier_share) };
        if good {
            self.look_for_closure(frame, &pose, &mut seen, happenings)?;
            primary = self.choose_primary(primary, &mut seen, happenings)?;
        }
        self.leave(&mut seen, happenings);
        for (beside, seen) in self.beside.iter_mut().zip(&seen) {
            let local = &mut beside.local;
            self.mapper.follow_beside(local.submap, &mut local.model, &seen.pose)?;
            local.submap_from_model = Some(seen.pose);
            if seen.good {
                local.last_good = Some(seen.pose);
            }
            local.motion.moved_to(frame, seen.pose);
        }
        if let Some(atlas) = &mut self.atlas {
            let counts = |(beside, seen): &(&Beside, &Seen)| good && seen.good && beside.life.is_settled();
            let beside = self.beside.iter().zip(&seen).filter(counts);
            let beside = beside.map(|(beside, seen)| seen.in_submap(beside.local.submap)).collect();
            atlas.moved_to(frame.timestamp, primary.in_submap(self.primary.submap), beside);
            // Where the map is only looked at, its submaps stay where they are.
            if self.settings.map.fuse {
                happenings.extend(atlas.optimise(self.mapper.frames()));
            }
        }
        Ok(primary.pose)
    }

    /// Tracks the frame in the submaps beside the primary, and measures where those lie.
    fn track_beside(
        &mut self,
        frame: &Frame,
        step: Option<Se3>,
        in_primary: Option<(&Se3, Option<&Tracked>)>,
        happenings: &mut Vec<Happening>,
    ) -> Result<Vec<Seen>, Error> {
        let Self { beside, atlas, primary, evaluator, view, calibration, settings, .. } = self;
        let mut eyes = Eyes { evaluator, view, calibration, settings };
        let mut seen = Vec::new();
        for Beside { local, life } in beside {
            let last = local.submap_from_model.unwrap_or_default();
            // The camera moves in each submap as it does in the primary.
            let expected = step.map_or(last, |step| last * step);
            let found = local.track_from(&mut eyes, frame, &[expected])?;
            let share = found.as_ref().map_or(0.0, |found| found.inlier_share);
            let good = found.as_ref().is_some_and(|found| found.verdict == Verdict::Good)
                && share >= settings.submaps.min_inlier_share;
            life.failed = if good { 0 } else { life.failed + 1 };
            let pose = found.as_ref().filter(|_| good).map_or(expected, |found| found.estimate);
            if let Some(trial) = &mut life.trial {
                trial.tries += 1;
                trial.successes += u32::from(good);
            }
            if let (Some((in_primary, Some(tracked))), Some(found), Some(atlas)) =
                (in_primary, found.filter(|_| good), atlas.as_mut())
            {
                // One link for both directions.
                let mut sides =
                    [(primary.submap, in_primary, &tracked.covariance), (local.submap, &pose, &found.covariance)];
                sides.sort_by_key(|(submap, ..)| *submap);
                let [(one, in_one, of_one), (other, in_other, of_other)] = sides;
                let observation = Observation::new([in_one, in_other], [of_one, of_other], &settings.submaps);
                if let Some(trial) = &mut life.trial {
                    trial.link.observe(observation, &settings.submaps);
                } else {
                    let link = atlas.observe([one, other], observation);
                    happenings.extend(link.map(|link| Happening::Linked { from: link.from, to: link.to }));
                }
            }
            seen.push(Seen { pose, good, share });
        }
        Ok(seen)
    }

    /// Accepts closures that were confirmed, and gives up those that were not.
    fn end_trials(&mut self, pose: &Se3, seen: &mut Vec<Seen>, happenings: &mut Vec<Happening>) {
        let settings = self.settings.submaps.clone();
        let Some(atlas) = &mut self.atlas else { return };
        let mut at = 0;
        while at < self.beside.len() {
            let Beside { local, life } = &mut self.beside[at];
            let Some(trial) = &life.trial else {
                at += 1;
                continue;
            };
            let to = local.submap;
            let ends = if trial.from != self.primary.submap {
                Some("the camera has left the submap that it was measured from".to_owned())
            } else if trial.successes >= settings.closure_successes {
                match trial.link.measured(&settings) {
                    Some(_) => None,
                    None => Some(format!(
                        "{:.0} % of the frames agree on where it lies",
                        100.0 * trial.link.agreement().unwrap_or(0.0)
                    )),
                }
            } else if trial.tries >= settings.closure_tries {
                Some(format!("{} of {} frames were tracked there", trial.successes, trial.tries))
            } else {
                at += 1;
                continue;
            };
            match ends {
                None => {
                    let from = self.primary.submap;
                    let moved_m = moved(atlas, from, pose, to, &seen[at].pose);
                    let trial = life.trial.take().expect("it is on trial");
                    atlas.close(trial.link);
                    atlas.set_state(to, SubmapState::Active);
                    happenings.push(Happening::ClosureAccepted { from, to, moved_m });
                    at += 1;
                }
                Some(reason) => {
                    happenings.push(Happening::ClosureRefused { submap: to, reason });
                    self.beside.remove(at);
                    seen.remove(at);
                }
            }
        }
    }

    /// Looks whether the camera is back in a passive submap.
    fn look_for_closure(
        &mut self,
        frame: &Frame,
        pose: &Se3,
        seen: &mut Vec<Seen>,
        happenings: &mut Vec<Happening>,
    ) -> Result<(), Error> {
        let now = self.mapper.frames();
        let on_trial = self.beside.iter().any(|beside| beside.life.trial.is_some());
        let settings = &self.settings.submaps;
        if !settings.close_loops || on_trial || now < self.next_look || !now.is_multiple_of(settings.look_every.into())
        {
            return Ok(());
        }
        self.leave_out_emptied()?;
        let settings = &self.settings.submaps;
        let (Some(atlas), Some(places)) = (&self.atlas, &mut self.places) else { return Ok(()) };
        let world_from_camera = atlas.world_from(self.primary.submap) * *pose;
        // Of passive submaps those that the camera can see much of, unless tracking has drifted more than it does: what looks
        // alike elsewhere would come before them.
        let may_be_here = |keyframe: &Keyframe| {
            let Keyframe { submap, submap_from_camera, .. } = keyframe;
            if usize::from(*submap) >= atlas.submaps.len() || atlas.submap(*submap).state != SubmapState::Passive {
                return false;
            }
            let off = (atlas.world_from(*submap) * *submap_from_camera).inverse() * world_from_camera;
            off.translation.length() <= atlas.drift_allowed_m(*submap) + settings.look_within_m
                && off.angle() <= settings.look_within_rad
        };
        let far_m = f64::from(self.settings.view.max_depth_m);
        let expected = |submap: u16| atlas.world_from(submap).inverse() * world_from_camera;
        let in_view = |submap: u16| atlas.share_in_view(submap, &self.calibration.depth, &expected(submap), far_m);
        // Where tracking cannot have drifted far, the camera is where it is thought to be, whatever the view resembles.
        let near = (0..atlas.submaps.len() as u16)
            .filter(|submap| atlas.submap(*submap).state == SubmapState::Passive && atlas.has_blocks(*submap))
            .filter(|submap| atlas.drift_allowed_m(*submap) <= settings.expected_within_m)
            .map(|submap| (in_view(submap), submap))
            .filter(|(share, _)| *share >= settings.new_below.max(settings.expected_share))
            .max_by(|(a, _), (b, _)| a.total_cmp(b));
        let mut candidates = places.candidates(&self.device, &may_be_here)?;
        candidates.retain(|candidate| candidate.dissimilarity <= settings.max_dissimilarity);
        candidates.truncate(settings.look_candidates as usize);
        if candidates.is_empty() && near.is_none() {
            return Ok(());
        }
        self.next_look = now + u64::from(settings.look_every) * (1 + u64::from(settings.look_rest));
        let Self { evaluator, view, calibration, mapper, .. } = self;
        let mut eyes = Eyes { evaluator, view, calibration, settings: &self.settings };
        let mut found = None;
        if let Some((_, submap)) = near {
            let tracked = places.find_near(mapper, &mut eyes, frame, submap, &expected(submap))?;
            found = tracked.map(|tracked| (submap, None, tracked.world_from_camera));
        }
        if found.is_none()
            && let Some(Found { candidate, tracked }) = places.find_among(mapper, &mut eyes, frame, &candidates)?
        {
            found = Some((candidate.keyframe.submap, Some(candidate.keyframe.id), tracked.world_from_camera));
        }
        let Some((submap, keyframe, there)) = found else { return Ok(()) };
        happenings.push(Happening::ClosureTried { submap, keyframe });
        let (moved_m, allowed_m) =
            (moved(atlas, self.primary.submap, pose, submap, &there), atlas.drift_allowed_m(submap));
        if moved_m > allowed_m {
            let reason = format!(
                "it would move the camera by {moved_m:.2} m, and tracking drifts by {allowed_m:.2} m at most \
                 (submaps.max_drift)"
            );
            happenings.push(Happening::ClosureRefused { submap, reason });
            return Ok(());
        }
        let local = self.new_local(submap)?;
        let life = Life { failed: 0, trial: Some(Trial::begin(self.primary.submap, submap)) };
        self.beside.push(Beside { local, life });
        seen.push(Seen { pose: there, good: true, share: 0.0 });
        Ok(())
    }

    /// A submap to be tracked in, which has not been looked at yet.
    pub(crate) fn new_local(&self, submap: u16) -> Result<Local, Error> {
        let tracker = &self.primary.tracker;
        let mut local = Local::new(&self.device, &self.calibration, tracker, &self.needs, submap)?;
        // The submap is as old as what it shows.
        local.age = self.primary.age;
        Ok(local)
    }

    /// Where the camera has left the middle of the primary, another active submap takes its place, or a new one begins.
    fn choose_primary(
        &mut self,
        primary: Seen,
        seen: &mut Vec<Seen>,
        happenings: &mut Vec<Happening>,
    ) -> Result<Seen, Error> {
        let camera = self.calibration.depth;
        let far_m = f64::from(self.settings.view.max_depth_m);
        let new_below = self.settings.submaps.new_below;
        let from = self.primary.submap;
        let pose = primary.pose;
        let Some(atlas) = &mut self.atlas else { return Ok(primary) };
        if !atlas.has_central(from) || atlas.share_in_view(from, &camera, &pose, far_m) >= new_below {
            return Ok(primary);
        }
        let settled = |at: &usize| {
            let Beside { local, life } = &self.beside[*at];
            life.trial.is_none() && seen[*at].good && atlas.is_measured(from, local.submap)
        };
        let share = |at: usize| atlas.share_in_view(self.beside[at].local.submap, &camera, &seen[at].pose, far_m);
        let best = (0..self.beside.len()).filter(settled).max_by(|a, b| share(*a).total_cmp(&share(*b)));
        if let Some(at) = best.filter(|at| share(*at) >= new_below) {
            let to = self.beside[at].local.submap;
            std::mem::swap(&mut self.primary, &mut self.beside[at].local);
            self.beside[at].life = Life::default();
            atlas.set_state(from, SubmapState::Active);
            atlas.set_state(to, SubmapState::Primary);
            happenings.push(Happening::Primary { submap: to, from });
            return Ok(std::mem::replace(&mut seen[at], primary));
        }
        // Nothing would be fused into a new one, or it would find no room.
        if !self.settings.map.fuse || !self.mapper.may_begin_submap() {
            return Ok(primary);
        }
        let Some(submap) = atlas.next_number() else { return Ok(primary) };
        if let Err(error) = self.mapper.begin_submap(submap) {
            return self.no_room_for_submap(error).map(|()| primary);
        }
        atlas.begin(from, &pose);
        atlas.set_state(from, SubmapState::Active);
        atlas.set_state(submap, SubmapState::Primary);
        let mut local = self.new_local(submap)?;
        local.age = Default::default();
        local.last_good = Some(Se3::IDENTITY);
        local.motion = self.primary.motion.seen_from(&pose.inverse());
        let old = std::mem::replace(&mut self.primary, local);
        self.beside.push(Beside { local: old, life: Life::default() });
        seen.push(primary);
        happenings.push(Happening::Submap { submap, from });
        // What began with the frame says nothing about its pose.
        Ok(Seen { pose: Se3::IDENTITY, good: true, share: 0.0 })
    }

    /// Leaves the submaps in which tracking has failed, and those that are too many.
    fn leave(&mut self, seen: &mut Vec<Seen>, happenings: &mut Vec<Happening>) {
        let camera = self.calibration.depth;
        let far_m = f64::from(self.settings.view.max_depth_m);
        let settings = &self.settings.submaps;
        let Some(atlas) = &mut self.atlas else { return };
        loop {
            let failed = |beside: &Beside| beside.life.trial.is_none() && beside.life.failed >= settings.passive_after;
            let mut gone = self.beside.iter().position(failed);
            if gone.is_none() && self.beside.len() + 1 > settings.max_active as usize {
                let share =
                    |at: usize| atlas.share_in_view(self.beside[at].local.submap, &camera, &seen[at].pose, far_m);
                let settled = (0..self.beside.len()).filter(|at| self.beside[*at].life.trial.is_none());
                gone = settled.min_by(|a, b| share(*a).total_cmp(&share(*b)));
            }
            let Some(at) = gone else { return };
            let submap = self.beside.remove(at).local.submap;
            seen.remove(at);
            atlas.set_state(submap, SubmapState::Passive);
            happenings.push(Happening::Passive { submap });
        }
    }

    /// Where the camera is by the other active submaps, when it was lost in the primary: the best by the verdict of tracking is
    /// the primary from here on.
    pub(crate) fn fall_back(
        &mut self,
        frame: &Frame,
        happenings: &mut Vec<Happening>,
    ) -> Result<Option<Tracked>, Error> {
        let Self { beside, evaluator, view, calibration, settings, .. } = self;
        let mut eyes = Eyes { evaluator, view, calibration, settings };
        let mut best: Option<(usize, Tracked)> = None;
        for (at, Beside { local, life }) in beside.iter_mut().enumerate() {
            if life.trial.is_some() || life.failed > 0 {
                continue;
            }
            let Some(found) = local.track(&mut eyes, frame, &[])? else { continue };
            let better = best.as_ref().is_none_or(|(_, best)| found.chance_wrong < best.chance_wrong);
            let enough = found.inlier_share >= settings.submaps.min_inlier_share;
            if found.verdict == Verdict::Good && enough && better {
                best = Some((at, found));
            }
        }
        let (Some((at, found)), Some(atlas)) = (best, &mut self.atlas) else { return Ok(None) };
        let from = self.primary.submap;
        self.primary = self.beside.remove(at).local;
        self.primary.last_good = Some(found.estimate);
        let submap = self.primary.submap;
        atlas.set_state(from, SubmapState::Passive);
        atlas.set_state(submap, SubmapState::Primary);
        happenings.push(Happening::Passive { submap: from });
        happenings.push(Happening::Primary { submap, from });
        Ok(Some(found))
    }

    /// The camera was found in a submap after a loss: it is the primary from here on.
    pub(crate) fn return_to(&mut self, submap: u16, happenings: &mut Vec<Happening>) -> Result<(), Error> {
        let from = self.primary.submap;
        if submap == from {
            // In a saved map it was none yet.
            if let Some(atlas) = &mut self.atlas {
                atlas.set_state(submap, SubmapState::Primary);
            }
            return Ok(());
        }
        let known = self.beside.iter().position(|beside| beside.local.submap == submap);
        let mut local = match known {
            Some(at) => self.beside.remove(at).local,
            None => self.new_local(submap)?,
        };
        local.tracker.learn(&self.primary.tracker.learnt());
        self.primary = local;
        // Where the camera was lost nobody knows how it got here.
        let Some(atlas) = &mut self.atlas else { return Ok(()) };
        atlas.set_state(from, SubmapState::Passive);
        atlas.set_state(submap, SubmapState::Primary);
        happenings.push(Happening::Passive { submap: from });
        happenings.push(Happening::Primary { submap, from });
        for gone in self.beside.drain(..) {
            atlas.set_state(gone.local.submap, SubmapState::Passive);
            happenings.push(Happening::Passive { submap: gone.local.submap });
        }
        Ok(())
    }

    /// Notes what the primary's first frame saw, once it was fused at a pose.
    pub(crate) fn note_central(&mut self, pose: &Se3) -> Result<(), Error> {
        let submap = self.primary.submap;
        if let Some(atlas) = &mut self.atlas
            && !atlas.has_central(submap)
        {
            let mut centres = self.mapper.block_centres(submap)?;
            if self.settings.map.index == MapIndex::Dense {
                // All of the box is there from the start.
                let far_m = f64::from(self.settings.view.max_depth_m);
                centres.retain(|centre| sees(&self.calibration.depth, pose, far_m, *centre));
            }
            atlas.set_central(submap, &centres);
        }
        Ok(())
    }
}

/// How far it is from where a camera is by one submap to where it is by another, in metres.
fn moved(atlas: &Atlas, from: u16, from_from_camera: &Se3, to: u16, to_from_camera: &Se3) -> f64 {
    let by = |submap, pose: &Se3| (atlas.world_from(submap) * *pose).translation;
    by(from, from_from_camera).distance(by(to, to_from_camera))
}

#[cfg(test)]
mod tests;
