//! One pose of several candidates.

use glam::{DQuat, DVec3};
use itm_core::{RelocaliserSettings, Se3};
use nalgebra::{Matrix4, SymmetricEigen, Vector4};

use crate::Candidate;

/// The mean of several candidates' poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AveragePose {
    /// The submap that the pose is relative to.
    pub submap: u16,
    /// The mean of the cameras' poses.
    pub submap_from_camera: Se3,
    /// Number of candidates that count in it, at least 1.
    pub candidates: usize,
}

/// The mean of candidates' poses, weighted by similarity, or none without candidates.
///
/// The first candidate, the most similar one of [`crate::Relocaliser::candidates`], says where. Of the first `average_of` those count
/// that are in its submap, within `average_within_m` metres and `average_within_rad` radians of it: a mean of poses in different
/// parts of a room would be somewhere where the camera never was. So there is a mean whenever there is a candidate; where no
/// other is near it, it is the candidate's own pose.
///
/// A pose weighs 1 - dissimilarity. Translations are averaged as they are; rotations as in Markley et al. 2007, *Averaging
/// Quaternions*: the mean is the unit quaternion that maximises `qᵀ (Σ wᵢ qᵢ qᵢᵀ) q`, which does not depend on the quaternions'
/// signs.
pub fn average_pose(candidates: &[Candidate], settings: &RelocaliserSettings) -> Option<AveragePose> {
    let first = candidates.first()?.keyframe;
    let candidates = &candidates[..candidates.len().min(settings.average_of as usize)];
    let camera_from_submap = first.submap_from_camera.inverse();
    let is_near = |candidate: &&Candidate| {
        let between = camera_from_submap * candidate.keyframe.submap_from_camera;
        candidate.keyframe.submap == first.submap
            && between.translation.length() <= settings.average_within_m
            && between.angle() <= settings.average_within_rad
    };
    // The first one whatever the limits: rounding puts it at an angle from itself.
    let counted: Vec<_> = candidates[..1].iter().chain(candidates[1..].iter().filter(is_near)).collect();
    if counted.len() == 1 {
        return Some(AveragePose { submap: first.submap, submap_from_camera: first.submap_from_camera, candidates: 1 });
    }
    let mut sum = 0.0;
    let mut translation = DVec3::ZERO;
    let mut outer = Matrix4::zeros();
    for candidate in &counted {
        // Above 0 even for candidates that a relocaliser would not give, so that there is always a mean.
        let weight = (1.0 - candidate.dissimilarity).max(1e-6);
        let pose = candidate.keyframe.submap_from_camera;
        let q = Vector4::from(pose.rotation.to_array());
        sum += weight;
        translation += weight * pose.translation;
        outer += weight * q * q.transpose();
    }
    let eigen = SymmetricEigen::new(outer);
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let rotation = DQuat::from_xyzw(q[0], q[1], q[2], q[3]);
    Some(AveragePose {
        submap: first.submap,
        submap_from_camera: Se3::new(rotation, translation / sum),
        candidates: counted.len(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Keyframe;
    use itm_core::Timestamp;
    use proptest::prelude::*;

    fn candidate(submap: u16, twist: [f64; 6], dissimilarity: f64) -> Candidate {
        let keyframe = Keyframe { id: 0, submap, submap_from_camera: Se3::exp(twist), timestamp: Timestamp(0) };
        Candidate { keyframe, dissimilarity }
    }

    fn mean(candidates: &[Candidate]) -> Option<AveragePose> {
        average_pose(candidates, &RelocaliserSettings::default())
    }

    proptest! {
        #[test]
        fn the_mean_of_poses_around_one_is_that_one(
            at in prop::array::uniform6(-1.5..1.5f64),
            off in prop::array::uniform6(-0.08..0.08f64),
            flip: bool,
        ) {
            let middle = Se3::exp(at);
            let mut one = candidate(0, [0.0; 6], 0.25);
            let mut other = one;
            one.keyframe.submap_from_camera = middle * Se3::exp(off);
            other.keyframe.submap_from_camera = middle * Se3::exp(off.map(|v| -v));
            // Half the sum of the two translations lies a little off the middle, for they are not on one screw.
            let expected = 0.5 * (one.keyframe.submap_from_camera.translation + other.keyframe.submap_from_camera.translation);
            if flip {
                other.keyframe.submap_from_camera.rotation = -other.keyframe.submap_from_camera.rotation;
            }
            let mean = mean(&[one, other]).unwrap();
            prop_assert_eq!(mean.candidates, 2);
            prop_assert!((middle.inverse() * mean.submap_from_camera).angle() < 1e-7);
            prop_assert!((mean.submap_from_camera.translation - expected).length() < 1e-12);
        }
    }

    #[test]
    fn the_more_similar_one_counts_more() {
        let pose = mean(&[candidate(0, [0.0; 6], 0.25), candidate(0, [0.2, 0.0, 0.0, 0.0, 0.0, 0.2], 0.75)]).unwrap();
        assert!((pose.submap_from_camera.translation.x - 0.05).abs() < 1e-3, "{pose:?}");
        assert!((pose.submap_from_camera.angle() - 0.05).abs() < 1e-3, "{pose:?}");
    }

    #[test]
    fn no_more_than_the_most_similar_ones_count() {
        let all = [0.0, 0.1, 0.2].map(|x| candidate(0, [x, 0.0, 0.0, 0.0, 0.0, 0.0], 0.5));
        let x = |average_of| {
            let settings = RelocaliserSettings { average_of, ..Default::default() };
            average_pose(&all, &settings).unwrap().submap_from_camera.translation.x
        };
        assert!((x(2) - 0.05).abs() < 1e-12 && (x(3) - 0.1).abs() < 1e-12 && (x(9) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn what_is_elsewhere_does_not_count() {
        let first = candidate(3, [1.0, 0.0, 0.0, 0.0, 0.4, 0.0], 0.5);
        let elsewhere = [
            candidate(4, [1.0, 0.0, 0.0, 0.0, 0.4, 0.0], 0.5),
            candidate(3, [2.0, 0.0, 0.0, 0.0, 0.4, 0.0], 0.5),
            candidate(3, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], 0.5),
        ];
        for other in elsewhere {
            let pose = mean(&[first, other]).unwrap();
            assert_eq!((pose.submap, pose.candidates), (3, 1));
            assert_eq!(pose.submap_from_camera, first.keyframe.submap_from_camera);
        }
        assert_eq!(mean(&[]), None);
    }
}
