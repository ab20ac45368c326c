use std::collections::HashSet;

use glam::{DQuat, DVec3};
use itm_core::{PoseError, Se3};
use serde::{Deserialize, Serialize};

use super::{POSE_BYTES, le};

/// Where a submap lies in the world, and what it is to the session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SubmapPose {
    /// The submap's number, as in its blocks' keys.
    pub submap: u16,
    /// Takes points of the submap's own frame to the world.
    pub world_from_submap: Se3,
    /// What it is to the session.
    pub state: SubmapState,
}

/// What a submap is to a session (Kähler et al. 2016, section 3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SubmapState {
    /// Kept, but not tracked against.
    #[default]
    Passive,
    /// Tracked against.
    Active,
    /// Tracked against, and what is seen is fused into it.
    Primary,
}

impl SubmapState {
    const ALL: [Self; 3] = [Self::Passive, Self::Active, Self::Primary];
}

/// What would do and what was found, where submaps' poses are none or a submap has two.
pub(super) fn check(submaps: &[SubmapPose]) -> Result<(), (String, String)> {
    let mut known = HashSet::new();
    for SubmapPose { submap, world_from_submap: pose, .. } in submaps {
        Se3::try_from_quaternion(pose.rotation, pose.translation)
            .map_err(|reason| ("poses".into(), format!("that the one of submap {submap} is none: {reason}")))?;
        if !known.insert(submap) {
            return Err(("a pose for each submap".into(), format!("two of submap {submap}")));
        }
    }
    Ok(())
}

pub(super) fn encode(submap: &SubmapPose) -> [u8; POSE_BYTES] {
    let mut bytes = pose_bytes(&submap.world_from_submap);
    bytes[..4].copy_from_slice(&u32::from(submap.submap).to_le_bytes());
    bytes[4..8].copy_from_slice(&(submap.state as u32).to_le_bytes());
    bytes
}

/// The inverse of [`encode`]; what would do and what was found, where there is none.
pub(super) fn decode(bytes: &[u8; POSE_BYTES]) -> Result<SubmapPose, (String, String)> {
    let (number, state) = (le(&bytes[..4], u32::from_le_bytes), le(&bytes[4..8], u32::from_le_bytes));
    let submap = u16::try_from(number).map_err(|_| ("submaps of 16 bits".into(), format!("number {number}")))?;
    let known = SubmapState::ALL.into_iter().find(|known| *known as u32 == state);
    let unknown = || ("states 0, 1 and 2".into(), format!("state {state} of submap {submap}"));
    Ok(SubmapPose { submap, world_from_submap: pose_in(bytes), state: known.ok_or_else(unknown)? })
}

/// A pose behind eight bytes for what it is the pose of, which are 0.
pub(super) fn pose_bytes(pose: &Se3) -> [u8; POSE_BYTES] {
    let (t, q) = (pose.translation, pose.rotation);
    let mut bytes = [0; POSE_BYTES];
    for (bytes, number) in bytes.as_chunks_mut::<8>().0[1..].iter_mut().zip([t.x, t.y, t.z, q.x, q.y, q.z, q.w]) {
        *bytes = number.to_le_bytes();
    }
    bytes
}

/// The inverse of [`pose_bytes`], to the bit, whether it is a pose or not.
fn pose_in(bytes: &[u8; POSE_BYTES]) -> Se3 {
    let number = |at: usize| le(&bytes[8 * at..][..8], f64::from_le_bytes);
    Se3 {
        rotation: DQuat::from_xyzw(number(4), number(5), number(6), number(7)),
        translation: DVec3::new(number(1), number(2), number(3)),
    }
}

/// The inverse of [`pose_bytes`], to the bit.
pub(super) fn checked_pose_in(bytes: &[u8; POSE_BYTES]) -> Result<Se3, PoseError> {
    let pose = pose_in(bytes);
    // Only asked whether it is one: normalised once more it would not be the same to the bit.
    Se3::try_from_quaternion(pose.rotation, pose.translation)?;
    Ok(pose)
}
