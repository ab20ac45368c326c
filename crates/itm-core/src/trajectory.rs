//! Poses over time.

use crate::{Se3, Timestamp};

/// A camera pose at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// When.
    pub timestamp: Timestamp,
    /// The camera's pose in the world.
    pub world_from_camera: Se3,
}

/// Poses in the order of their time stamps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
}

impl Trajectory {
    /// A trajectory from poses in any order; they are sorted by time (stably).
    pub fn new(mut poses: Vec<StampedPose>) -> Self {
        poses.sort_by_key(|p| p.timestamp);
        Self { poses }
    }

    /// Of poses at the same time the one that was added last: where a recording was gone back in, frames have several.
    #[must_use]
    pub fn last_of_each_time(&self) -> Self {
        let last = |(at, pose): &(usize, &StampedPose)| {
            self.poses.get(at + 1).is_none_or(|next| next.timestamp != pose.timestamp)
        };
        Self { poses: self.poses.iter().enumerate().filter(last).map(|(_, pose)| *pose).collect() }
    }

    /// Adds a pose; its place follows from its time stamp.
    pub fn push(&mut self, pose: StampedPose) {
        let at = self.poses.partition_point(|p| p.timestamp <= pose.timestamp);
        self.poses.insert(at, pose);
    }

    /// The poses, by time.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// The pose nearest in time, if one lies within `tolerance_ns` nanoseconds; the earlier one of two equally near.
    pub fn nearest(&self, timestamp: Timestamp, tolerance_ns: i64) -> Option<&StampedPose> {
        let at = self.poses.partition_point(|p| p.timestamp < timestamp);
        let distance = |p: &&StampedPose| p.timestamp.0.saturating_sub(timestamp.0).saturating_abs();
        let before = at.checked_sub(1).and_then(|i| self.poses.get(i));
        before.into_iter().chain(self.poses.get(at)).min_by_key(distance).filter(|p| distance(p) <= tolerance_ns)
    }
}

impl FromIterator<StampedPose> for Trajectory {
    fn from_iter<I: IntoIterator<Item = StampedPose>>(poses: I) -> Self {
        Self::new(poses.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_pose_is_found_within_the_tolerance() {
        let at = |ns| StampedPose { timestamp: Timestamp(ns), world_from_camera: Se3::IDENTITY };
        let trajectory: Trajectory = [at(30), at(10), at(20)].into_iter().collect();
        let nearest = |ns, tolerance| trajectory.nearest(Timestamp(ns), tolerance).map(|p| p.timestamp.0);
        assert_eq!(nearest(14, 5), Some(10));
        assert_eq!(nearest(16, 5), Some(20));
        assert_eq!(nearest(15, 5), Some(10));
        assert_eq!(nearest(40, 5), None);
        assert_eq!(Trajectory::default().nearest(Timestamp(0), i64::MAX), None);
    }

    #[test]
    fn of_poses_at_one_time_the_last_added_is_kept() {
        let at = |ns, x| StampedPose {
            timestamp: Timestamp(ns),
            world_from_camera: Se3 { translation: glam::DVec3::X * x, ..Se3::IDENTITY },
        };
        let mut trajectory: Trajectory = [at(10, 0.0), at(20, 0.0), at(30, 0.0)].into_iter().collect();
        trajectory.push(at(20, 1.0));
        trajectory.push(at(30, 2.0));
        assert_eq!(trajectory.len(), 5);
        assert_eq!(trajectory.last_of_each_time().poses(), [at(10, 0.0), at(20, 1.0), at(30, 2.0)]);
        assert!(Trajectory::default().last_of_each_time().is_empty());
    }
}
