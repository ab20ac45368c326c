//! Submaps that come from a file: what a session can use of them.

use std::collections::BTreeSet;

use itm_core::{PoseError, Se3, SubmapSettings};
use itm_io::map_file::{SubmapPose, SubmapState};

use super::{Atlas, AtlasState, Submap};

/// A part of a file that is no use: which, and why.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LeftOut {
    /// With its verb.
    pub(crate) what: String,
    pub(crate) reason: String,
}

/// A pose as it was read, or why it is none.
pub(crate) fn check_pose(pose: &Se3) -> Result<(), PoseError> {
    Se3::try_from_quaternion(pose.rotation, pose.translation).map(|_| ())
}

impl AtlasState {
    /// Keeps what another session can use.
    pub(crate) fn forget_session(&mut self) {
        self.frames.clear();
        self.beside.clear();
        self.live.clear();
        self.running = None;
    }

    /// Leaves out what is no use and what nothing else depends on.
    ///
    /// # Errors
    /// What is wrong with the submaps themselves.
    pub(crate) fn check(&mut self, settings: &SubmapSettings) -> Result<Vec<LeftOut>, String> {
        self.check_submaps()?;
        let mut left_out = Vec::new();
        let mut leave_out = |what: String, reason: String| left_out.push(LeftOut { what, reason });
        for (number, submap) in self.submaps.iter_mut().enumerate() {
            if let Some((parent, pose)) = submap.parent {
                let reason = match check_pose(&pose) {
                    Err(reason) => Some(reason.to_string()),
                    Ok(()) if usize::from(parent) >= number => Some(format!("submap {parent} is no earlier one")),
                    Ok(()) => None,
                };
                if let Some(reason) = reason {
                    submap.parent = None;
                    leave_out(format!("where submap {number} began is"), reason);
                }
            }
            let before = submap.central.len();
            submap.central.retain(|centre| centre.iter().all(|metres| metres.is_finite()));
            let gone = before - submap.central.len();
            if gone > 0 {
                let reason = "their coordinates are not finite".into();
                leave_out(format!("{gone} central blocks of submap {number} are"), reason);
            }
        }
        let (submaps, mut known) = (self.submaps.len(), BTreeSet::new());
        self.links.retain(|link| {
            let checked = link
                .check(submaps)
                .and_then(|()| if known.insert(link.key()) { Ok(()) } else { Err("there is another one".into()) });
            checked
                .map_err(|reason| {
                    leave_out(format!("the link from submap {} to submap {} is", link.from, link.to), reason)
                })
                .is_ok()
        });
        if let Some((_, Some((poses, _)))) = &self.running {
            let wrong = poses.iter().find_map(|pose| check_pose(pose).err()).map(|reason| reason.to_string());
            let wrong = wrong.or((poses.len() > submaps).then(|| format!("it has {} poses", poses.len())));
            if let Some(reason) = wrong {
                self.running = None;
                self.unused = self.unused.max(settings.optimise_every);
                leave_out("the last optimisation's result is".into(), format!("{reason}; another one begins"));
            }
        }
        self.beside.resize(self.frames.len(), (1.0, Vec::new()));
        let mut wrong = 0;
        for (weight, beside) in &mut self.beside {
            let counts = |weight: f64| weight.is_finite() && weight >= 0.0;
            let before = beside.len();
            beside.retain(|pose| {
                usize::from(pose.submap) < submaps
                    && counts(pose.weight)
                    && check_pose(&pose.submap_from_camera).is_ok()
            });
            wrong += before - beside.len();
            if !counts(*weight) {
                (*weight, wrong) = (1.0, wrong + 1);
            }
        }
        if wrong > 0 {
            let reason = "they are in submaps that are not there, or none".into();
            leave_out(format!("{wrong} of the frames' poses in further submaps are"), reason);
        }
        let mut gone = [0, 0];
        let usable: Vec<bool> = (self.frames.iter().zip(&self.live))
            .map(|((_, submap, pose), live)| {
                let there = usize::from(*submap) < submaps;
                let sound = check_pose(pose).and_then(|()| check_pose(live)).is_ok();
                gone[0] += usize::from(!there);
                gone[1] += usize::from(there && !sound);
                there && sound
            })
            .collect();
        for (count, reason) in gone.into_iter().zip(["they are in submaps that are not there", "their poses are none"])
        {
            if count > 0 {
                leave_out(format!("{count} frames of the trajectory are"), reason.into());
            }
        }
        let mut keep = usable.iter();
        self.frames.retain(|_| keep.next() == Some(&true));
        let mut keep = usable.iter();
        self.beside.retain(|_| keep.next() == Some(&true));
        let mut keep = usable.iter();
        self.live.retain(|_| keep.next() == Some(&true));
        Ok(left_out)
    }

    fn check_submaps(&self) -> Result<(), String> {
        if self.submaps.is_empty() || self.submaps.len() > usize::from(u16::MAX) {
            return Err(format!("it has {} submaps, where 1 to {} can be", self.submaps.len(), u16::MAX));
        }
        for (number, submap) in self.submaps.iter().enumerate() {
            let pose = check_pose(&submap.world_from_submap);
            pose.map_err(|reason| format!("the pose of submap {number} in the world is none: {reason}"))?;
        }
        let ways = self.submaps.iter().map(|submap| submap.left_at_m).chain([self.way_m]);
        if let Some(wrong) = ways.into_iter().find(|way_m| !(way_m.is_finite() && *way_m >= 0.0)) {
            return Err(format!("the camera has gone {wrong} m, which is no way"));
        }
        if self.frames.len() != self.live.len() {
            let (frames, live) = (self.frames.len(), self.live.len());
            return Err(format!("it has {frames} frames, but {live} poses of frames as they were found"));
        }
        Ok(())
    }
}

impl Atlas {
    /// Of a map in which nothing is known of the submaps but where they lie.
    ///
    /// # Errors
    /// Where they are not numbered as a session does.
    pub(crate) fn of_poses(settings: &SubmapSettings, poses: &[SubmapPose]) -> Result<Self, String> {
        let mut poses = poses.to_vec();
        poses.sort_by_key(|pose| pose.submap);
        if let Some((expected, pose)) = (0_u16..).zip(&poses).find(|(number, pose)| *number != pose.submap) {
            return Err(format!(
                "it has a submap {}, but none {expected}: sessions number them without gaps",
                pose.submap
            ));
        }
        let submap = |pose: &SubmapPose| Submap {
            world_from_submap: pose.world_from_submap,
            state: SubmapState::Passive,
            parent: None,
            central: Vec::new(),
            left_at_m: 0.0,
        };
        Ok(Self { submaps: poses.iter().map(submap).collect(), ..Self::new(settings) })
    }

    /// Makes the submaps what the session is to them: which one frames are fused into, and in which others the camera is
    /// tracked. `tracked` says whether the camera is known to be in the first. What was otherwise.
    pub(crate) fn set_roles(&mut self, primary: u16, tracked: bool, active: &[u16]) -> Vec<LeftOut> {
        let mut left_out = Vec::new();
        for (number, submap) in (0_u16..).zip(&mut self.submaps) {
            let role = match () {
                // In a map that a session began in, where the camera was not found yet.
                () if number == primary && !tracked => SubmapState::Passive,
                () if number == primary => SubmapState::Primary,
                () if active.contains(&number) => SubmapState::Active,
                () => SubmapState::Passive,
            };
            if submap.state != role {
                let name = |state| match state {
                    SubmapState::Passive => "passive",
                    SubmapState::Active => "active",
                    SubmapState::Primary => "primary",
                };
                left_out.push(LeftOut {
                    what: format!("that submap {number} is {} is", name(submap.state)),
                    reason: format!("the session has it as {}, and submap {primary} as primary", name(role)),
                });
                submap.state = role;
            }
        }
        left_out
    }
}
