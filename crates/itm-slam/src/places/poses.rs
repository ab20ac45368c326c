//! Poses around others, where a camera is looked for. Metres and radians, in the camera's frame (x right, y down, z forward).

use itm_core::Se3;

/// Whether two poses of cameras in one frame are within so many metres and radians of each other.
pub(super) fn is_near(a: &Se3, b: &Se3, within_m: f64, within_rad: f64) -> bool {
    let between = a.inverse() * *b;
    between.translation.length() <= within_m && between.angle() <= within_rad
}

/// Other poses that a frame's view is taken to, relative to its own (`view_from_moved`), to be compared with keyframes as it would
/// look from there: steps, and the same turned to the sides. The view's own is not among them.
pub(super) fn moves(reach_m: f64, reach_rad: f64) -> Vec<Se3> {
    // Further turned, little of the view is still in view.
    let yaws = to_both_sides(&[0.6 * reach_rad]);
    yaws.iter().flat_map(|yaw| steps(reach_m).into_iter().map(|step| step * turned(0.0, *yaw, 0.0))).skip(1).collect()
}

/// Poses around a keyframe's, itself first: as far as most of its view is still in view.
pub(super) fn around_keyframe(pose: &Se3, reach_m: f64, reach_rad: f64) -> Vec<Se3> {
    let mut poses = Vec::new();
    for yaw in to_both_sides(&[0.5 * reach_rad, reach_rad]) {
        poses.extend(steps(reach_m).into_iter().map(|step| *pose * step * turned(0.0, yaw, 0.0)));
    }
    // Cameras are turned to the sides more than up and down, and roll about the axis keeps the view.
    for pitch in to_both_sides(&[0.4 * reach_rad]).into_iter().skip(1) {
        poses.push(*pose * turned(pitch, 0.0, 0.0));
        poses.push(*pose * turned(0.0, 0.0, 2.0 * pitch));
    }
    poses
}

/// None, aside, ahead and back.
fn steps(reach_m: f64) -> Vec<Se3> {
    let along = |axis: usize, metres: f64| {
        let mut twist = [0.0; 6];
        twist[axis] = metres;
        Se3::exp(twist)
    };
    let half = 0.5 * reach_m;
    let aside = to_both_sides(&[half]).into_iter().map(|x| along(0, x));
    let ahead = to_both_sides(&[half, reach_m]).into_iter().skip(1).map(|z| along(2, z));
    aside.chain(ahead).collect()
}

/// None, and each of some amounts in both directions; none alone where they are 0.
fn to_both_sides(amounts: &[f64]) -> Vec<f64> {
    let amounts = amounts.iter().filter(|amount| **amount > 0.0);
    std::iter::once(0.0).chain(amounts.flat_map(|amount| [*amount, -*amount])).collect()
}

fn turned(pitch: f64, yaw: f64, roll: f64) -> Se3 {
    Se3::exp([0.0, 0.0, 0.0, pitch, yaw, roll])
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_are_within_reach_and_none_is_twice() {
        for (reach_m, reach_rad, counts) in
            [(0.6, 0.4, [20, 39]), (0.0, 0.4, [2, 9]), (0.6, 0.0, [6, 7]), (0.0, 0.0, [0, 1])]
        {
            let around = around_keyframe(&Se3::IDENTITY, reach_m, reach_rad);
            let moves = moves(reach_m, reach_rad);
            assert_eq!((around[0], [moves.len(), around.len()]), (Se3::IDENTITY, counts));
            for poses in [[&[Se3::IDENTITY], &moves[..]].concat(), around] {
                assert!(poses.iter().all(|pose| is_near(&Se3::IDENTITY, pose, reach_m + 1e-9, reach_rad + 1e-9)));
                for (at, pose) in poses.iter().enumerate() {
                    assert!(!poses[..at].iter().any(|other| is_near(other, pose, 0.01, 0.01)), "{pose:?}");
                }
            }
        }
    }

    #[test]
    fn poses_are_around_the_one_given() {
        let pose = Se3::exp([1.0, 2.0, 3.0, 0.3, -0.2, 0.1]);
        let relative = around_keyframe(&Se3::IDENTITY, 0.6, 0.4);
        for (around, relative) in around_keyframe(&pose, 0.6, 0.4).iter().zip(&relative) {
            assert!(is_near(around, &(pose * *relative), 1e-9, 1e-7));
        }
        // A degree short of a whole turn is a degree away.
        let turn = |degrees: f64| turned(0.0, degrees.to_radians(), 0.0);
        assert!(is_near(&turn(359.0), &turn(0.0), 0.0, 0.02) && !is_near(&turn(2.0), &turn(0.0), 0.0, 0.02));
    }
}
