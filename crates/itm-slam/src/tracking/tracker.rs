//! The kinds of tracker, and how several work together.

use std::sync::Arc;

use itm_core::{CompositePolicy, Frame, Intrinsics, Se3, Settings, TrackerKind, TrackerSettings};
use itm_io::trajectory::PoseFiles;
use serde::{Deserialize, Serialize};

use super::plan::{Age, Plan};
use super::{
    Exposure, Guess, Motion, Noise, NormalEquations, Objective, Tracked, Verdict, classifier, optimise, optimise_each,
    verdict,
};
use crate::Error;

/// A frame to be tracked, and what is known at that moment.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// The frame.
    pub frame: &'a Frame,
    /// The camera's motion so far.
    pub motion: &'a Motion,
    /// The map's age.
    pub age: Age,
    /// Whether the last pose may be wrong, after a loss, so that coming from near it speaks for nothing.
    pub in_doubt: bool,
}

/// What a tracker has learnt of the sensor, and those that it is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learnt {
    /// Of each term.
    pub noise: Noise,
    /// Between the map's colours and the last frame's.
    pub map_exposure: Exposure,
    /// Of a composite.
    #[serde(default)]
    pub parts: Vec<Learnt>,
}

/// A tracker, with what it has learnt of the sensor.
#[derive(Clone, Debug)]
pub struct Tracker {
    settings: Settings,
    /// The depth camera, at full resolution.
    camera: Intrinsics,
    /// Of a composite.
    parts: Vec<Tracker>,
    noise: Noise,
    /// Between the map's colours and the last frame's.
    map_exposure: Exposure,
    /// Of the kind that takes poses from files.
    poses: Option<Arc<PoseFiles>>,
}

impl Tracker {
    /// Of points with colours every so many along both axes are compared.
    pub(crate) fn every_point(&self) -> u32 {
        // Where a composite compares colours in another way too, it takes all of them.
        let TrackerSettings { kind, rgb, .. } = &self.settings.tracker;
        if *kind == TrackerKind::Rgb && rgb.skip_points { 2 } else { 1 }
    }

    /// Prepares the tracker that the settings choose, for a depth camera.
    ///
    /// # Errors
    /// Where the settings cannot be used.
    pub fn new(settings: &Settings, camera: &Intrinsics) -> Result<Self, Error> {
        let parts = match settings.tracker.kind {
            TrackerKind::Composite => settings.tracker.parts()?,
            _ => Vec::new(),
        };
        let parts = parts
            .into_iter()
            .map(|tracker| Self::new(&Settings { tracker, ..settings.clone() }, camera))
            .collect::<Result<_, _>>()?;
        let poses = match settings.tracker.kind {
            TrackerKind::File => Some(Arc::new(PoseFiles::new("".as_ref(), &settings.tracker.file.mask)?)),
            _ => None,
        };
        let (noise, map_exposure) = (Noise::default(), Exposure::default());
        Ok(Self { settings: settings.clone(), camera: *camera, parts, noise, map_exposure, poses })
    }

    /// Takes over valid settings that ask for the same kind of tracker, made of the same parts on the same levels. What it
    /// has learnt stays, as do files that are open.
    pub(crate) fn change_settings(&mut self, settings: &Settings) {
        if !self.parts.is_empty()
            && let Ok(parts) = settings.tracker.parts()
        {
            for (part, tracker) in self.parts.iter_mut().zip(parts) {
                part.change_settings(&Settings { tracker, ..settings.clone() });
            }
        }
        self.settings = settings.clone();
    }

    /// What it has learnt so far.
    pub fn learnt(&self) -> Learnt {
        let parts = self.parts.iter().map(Self::learnt).collect();
        Learnt { noise: self.noise, map_exposure: self.map_exposure, parts }
    }

    /// Takes over what another one has learnt.
    pub fn learn(&mut self, learnt: &Learnt) {
        self.noise = learnt.noise;
        self.map_exposure = learnt.map_exposure;
        for (part, learnt) in self.parts.iter_mut().zip(&learnt.parts) {
            part.learn(learnt);
        }
    }

    /// The pose that a file holds for a frame; `None` for trackers that take none from files.
    pub(crate) fn pose_from_file(&self, frame: &Frame) -> Option<Result<Option<Se3>, Error>> {
        let poses = self.poses.as_ref()?;
        Some(poses.read(frame.index, frame.timestamp).map_err(Error::from))
    }

    /// Whether the tracker, or one that it is made of, takes poses from files.
    pub(crate) fn takes_poses(&self) -> bool {
        self.poses.is_some() || self.parts.iter().any(Self::takes_poses)
    }

    /// The plans that the tracker, and those that it is made of, carry out.
    pub fn plans(&self, age: Age) -> Vec<Plan> {
        if self.settings.tracker.kind == TrackerKind::Composite {
            return self.parts.iter().flat_map(|part| part.plans(age)).collect();
        }
        self.plan(age).into_iter().collect()
    }

    fn plan(&self, age: Age) -> Option<Plan> {
        let settings = &self.settings;
        let t = &settings.tracker;
        match t.kind {
            TrackerKind::Icp => Some(Plan::icp(settings, &t.icp, &t.icp.levels)),
            TrackerKind::ImuIcp => Some(Plan::icp(settings, &t.icp, &t.imu.icp_levels)),
            TrackerKind::Extended => Some(Plan::extended(settings, &t.extended, &t.extended.levels, age)),
            TrackerKind::ExtendedImu => Some(Plan::extended(settings, &t.extended, &t.imu.extended_levels, age)),
            TrackerKind::Rgb => Some(Plan::rgb(settings, &t.rgb)),
            TrackerKind::File | TrackerKind::ForceFail | TrackerKind::Composite => None,
        }
    }

    /// Finds a frame's pose. `further` are poses to start from beside those that the camera's motion suggests.
    ///
    /// # Errors
    /// Where the device was lost, or a file with poses cannot be read. That tracking failed is no error but a verdict.
    pub fn track(
        &mut self,
        objective: &mut dyn Objective,
        moment: &Moment<'_>,
        further: &[Se3],
    ) -> Result<Tracked, Error> {
        let starts = self.starts(moment, further);
        self.track_from(objective, moment, &starts)
    }

    /// Finds a frame's pose from certain poses.
    ///
    /// # Errors
    /// As [`Tracker::track`].
    pub fn track_from(
        &mut self,
        objective: &mut dyn Objective,
        moment: &Moment<'_>,
        starts: &[Se3],
    ) -> Result<Tracked, Error> {
        let Moment { frame, motion, age, in_doubt } = *moment;
        let held = motion.last().or(starts.first().copied()).unwrap_or_default();
        match self.settings.tracker.kind {
            TrackerKind::ForceFail => Ok(Tracked::lost(held, "this tracker always fails".into())),
            TrackerKind::File => match self.pose_from_file(frame).transpose()?.flatten() {
                Some(pose) => Ok(Tracked::given(pose)),
                None => Ok(Tracked::lost(held, format!("no file holds a pose of frame {}", frame.index))),
            },
            TrackerKind::Composite => self.track_composite(objective, moment, starts),
            _ => {
                let plan = self.plan(age).expect("every other kind has a plan");
                let mut exposure = [Exposure::default(); 2];
                exposure[super::Against::Map as usize] = self.map_exposure;
                let guesses: Vec<Guess> = starts.iter().map(|p| Guess { world_from_camera: *p, exposure }).collect();
                let outcome = optimise(objective, &guesses, &plan, &self.noise)?;
                let level = classifier::check_level(&self.camera);
                let checked = objective.evaluate(&outcome.guess, &classifier::check(level))?;
                let ended = verdict::Ended {
                    plan: &plan,
                    outcome: &outcome,
                    checked: &checked,
                    pixels: self.camera.at_level(level as u32).pixels(),
                    expected: (!in_doubt).then(|| motion.predicted(frame.timestamp).unwrap_or(held)),
                    held,
                };
                let tracked = verdict::judge(&self.settings.tracker.verdict, &ended);
                if tracked.verdict == Verdict::Good {
                    self.noise = self.noise.measured(&outcome.last);
                    self.map_exposure = outcome.guess.exposure[super::Against::Map as usize];
                }
                Ok(tracked)
            }
        }
    }

    /// Of several poses those where the error over the whole frame is the least at the coarsest level, the best first.
    ///
    /// # Errors
    /// Where the device was lost.
    pub(crate) fn shortlist(
        &self,
        objective: &mut dyn Objective,
        age: Age,
        poses: &[Se3],
        most: usize,
    ) -> Result<Vec<Se3>, Error> {
        let Some(plan) = self.plan(age) else { return Ok(Vec::new()) };
        let Some(level) = plan.levels.first() else { return Ok(Vec::new()) };
        let guesses: Vec<Guess> = poses.iter().map(|pose| Guess::at(*pose)).collect();
        let evaluations = objective.evaluate_all(&guesses, &level.request)?;
        let error = |evaluation| {
            NormalEquations::new(evaluation, &level.request, &plan, &self.noise, plan.colour_weight).cost_of_all
        };
        let mut ranked: Vec<_> = evaluations.iter().map(error).zip(poses.iter().copied()).collect();
        ranked.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        Ok(ranked.into_iter().take(most).map(|(_, pose)| pose).collect())
    }

    /// Where several poses lead, and the error over the whole frame there, the least first. No verdict.
    ///
    /// # Errors
    /// Where the device was lost.
    pub(crate) fn refine(
        &self,
        objective: &mut dyn Objective,
        age: Age,
        starts: &[Se3],
    ) -> Result<Vec<(f64, Se3)>, Error> {
        let Some(plan) = self.plan(age) else { return Ok(Vec::new()) };
        let starts: Vec<Guess> = starts.iter().map(|start| Guess::at(*start)).collect();
        let mut refined = Vec::new();
        for (guess, equations) in optimise_each(objective, &starts, &plan, &self.noise)? {
            if let Some(equations) = equations.filter(|_| guess.world_from_camera.is_finite()) {
                refined.push((equations.cost_of_all, guess.world_from_camera));
            }
        }
        refined.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        Ok(refined)
    }

    fn track_composite(
        &mut self,
        objective: &mut dyn Objective,
        moment: &Moment<'_>,
        starts: &[Se3],
    ) -> Result<Tracked, Error> {
        let policy = self.settings.tracker.composite.policy;
        let mut best: Option<Tracked> = None;
        let mut starts = starts.to_vec();
        for part in &mut self.parts {
            let found = part.track_from(objective, moment, &starts)?;
            match policy {
                CompositePolicy::FirstSuccess => {
                    let better = best.as_ref().is_none_or(|b| found.verdict < b.verdict);
                    let good = found.verdict == Verdict::Good;
                    if better {
                        best = Some(found);
                    }
                    if good {
                        break;
                    }
                }
                CompositePolicy::Refine => {
                    starts = vec![found.estimate];
                    best = Some(found);
                }
                CompositePolicy::Sequential => {
                    starts = vec![found.estimate];
                    let lost = found.verdict == Verdict::Lost;
                    best = Some(match best {
                        Some(before) if before.verdict > found.verdict => {
                            Tracked { verdict: before.verdict, reasons: before.reasons, ..found }
                        }
                        _ => found,
                    });
                    if lost {
                        break;
                    }
                }
            }
        }
        Ok(best.expect("a composite has at least one tracker"))
    }

    /// Poses to start from, the likeliest first.
    fn starts(&self, moment: &Moment<'_>, further: &[Se3]) -> Vec<Se3> {
        let Moment { frame, motion, .. } = *moment;
        let t = &self.settings.tracker;
        let imu = |kind: TrackerKind| matches!(kind, TrackerKind::ImuIcp | TrackerKind::ExtendedImu);
        let uses_imu = imu(t.kind) || self.parts.iter().any(|part| imu(part.settings.tracker.kind));
        let mut starts = Vec::new();
        let turned = if uses_imu { motion.turned(frame, &t.imu) } else { None };
        let predicted = motion.predicted(frame.timestamp).filter(|_| t.predict_motion);
        starts.extend(match (turned, predicted) {
            // Where the camera goes as before, but turned as the sensor says.
            (Some(turned), Some(predicted)) => Some(Se3::new(turned.rotation, predicted.translation)),
            (turned, predicted) => turned.or(predicted),
        });
        starts.extend(motion.last());
        starts.extend(further);
        starts
    }
}
