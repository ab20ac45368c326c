//! Trees of frames, as ROS's tf2 keeps them: where one frame is in another at a moment.

use std::collections::HashMap;

use itm_core::{Se3, Timestamp};

use super::messages::StampedTransform;

/// Between measurements farther apart than this nothing is said.
const LARGEST_GAP_NS: i64 = 500_000_000;
/// So long before the first and after the last measurement a pose still counts.
const BEYOND_NS: i64 = 20_000_000;

/// The frame's name as tf2 compares it.
pub(super) fn frame_name(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

/// The pose at a moment between measured ones, which are in the order of time; a measured one as it is.
pub(super) fn interpolate<T>(samples: &[T], get: impl Fn(&T) -> (Timestamp, Se3), time: Timestamp) -> Option<Se3> {
    let after = samples.partition_point(|sample| get(sample).0 < time);
    let before = after.checked_sub(1).and_then(|i| samples.get(i)).map(&get);
    match (before, samples.get(after).map(&get)) {
        (_, Some((at, pose))) if at == time => Some(pose),
        (Some((a, from)), Some((b, to))) => {
            let (since, gap) = (time.0.saturating_sub(a.0), b.0.saturating_sub(a.0));
            if gap > LARGEST_GAP_NS {
                // The nearer one may be near enough by itself.
                return [(a, from), (b, to)].into_iter().find(|&(at, _)| is_near(at, time)).map(|(_, pose)| pose);
            }
            let share = since as f64 / gap as f64;
            let rotation = from.rotation.slerp(to.rotation, share);
            Some(Se3::new(rotation, from.translation.lerp(to.translation, share)))
        }
        (Some(near), None) | (None, Some(near)) => is_near(near.0, time).then_some(near.1),
        (None, None) => None,
    }
}

fn is_near(a: Timestamp, b: Timestamp) -> bool {
    a.0.saturating_sub(b.0).saturating_abs() <= BEYOND_NS
}

/// Where a frame is in its parent.
#[derive(Debug)]
struct Edge {
    parent: String,
    /// In the order of time once the tree is whole.
    samples: Vec<(Timestamp, Se3)>,
    /// Holds at all times.
    fixed: bool,
}

/// A tree of frames, or several.
#[derive(Debug, Default)]
pub(super) struct Frames {
    /// By the child's name.
    edges: HashMap<String, Edge>,
    /// Frames that were given two parents; the first one is kept.
    pub(super) with_two_parents: Vec<String>,
}

impl Frames {
    pub(super) fn new<'a>(transforms: impl IntoIterator<Item = (bool, &'a StampedTransform)>) -> Self {
        let mut frames = Self::default();
        for (fixed, StampedTransform { stamp, parent, child, parent_from_child }) in transforms {
            let Some(child) = child else { continue };
            let (parent, child) = (frame_name(parent), frame_name(child));
            let edge = frames.edges.entry(child.into()).or_insert_with(|| Edge {
                parent: parent.into(),
                samples: Vec::new(),
                fixed,
            });
            if edge.parent == parent {
                edge.samples.push((*stamp, *parent_from_child));
            } else if frames.with_two_parents.iter().all(|name| name != child) {
                frames.with_two_parents.push(child.into());
            }
        }
        for edge in frames.edges.values_mut() {
            edge.samples.sort_by_key(|&(stamp, _)| stamp);
            // What was said once holds from then on, and there is nothing to say what was before. Foxglove's transforms have no
            // word for what is fixed, so that it is said again and again.
            edge.fixed |= edge.samples.windows(2).all(|pair| pair[0].1 == pair[1].1);
        }
        frames
    }

    /// A frame and those that it lies in, up to the root.
    fn up<'a>(&'a self, from: &'a str) -> Vec<&'a str> {
        let mut way = vec![from];
        while let Some(edge) = way.last().and_then(|&frame| self.edges.get(frame)) {
            if way.contains(&edge.parent.as_str()) {
                break; // a circle, which no tree is
            }
            way.push(&edge.parent);
        }
        way
    }

    /// The frame that all of a frame's chain lies in, if something along the way moves.
    pub(super) fn moving_root(&self, frame: &str) -> Option<&str> {
        let way = self.up(frame_name(frame));
        let moves = way.iter().any(|frame| self.edges.get(*frame).is_some_and(|edge| !edge.fixed));
        let root = *way.last()?;
        // From this value and not from the frame's name.
        moves.then(|| self.edges.values().map(|edge| edge.parent.as_str()).find(|&parent| parent == root)).flatten()
    }

    /// When something was measured along a frame's chain: in order, each once.
    pub(super) fn times(&self, frame: &str) -> Vec<Timestamp> {
        let way = self.up(frame_name(frame));
        let edges = way.iter().filter_map(|frame| self.edges.get(*frame)).filter(|edge| !edge.fixed);
        let mut times: Vec<Timestamp> = edges.flat_map(|edge| edge.samples.iter().map(|&(time, _)| time)).collect();
        times.sort_unstable();
        times.dedup();
        times
    }

    /// Takes coordinates in frame `b` to frame `a` at a moment; `None` where the two are not connected then.
    pub(super) fn a_from_b(&self, a: &str, b: &str, time: Timestamp) -> Option<Se3> {
        let (a, b) = (frame_name(a), frame_name(b));
        let (up_a, up_b) = (self.up(a), self.up(b));
        let common = *up_b.iter().find(|frame| up_a.contains(frame))?;
        let common_from_a = self.along(&up_a, common, time)?;
        let common_from_b = self.along(&up_b, common, time)?;
        Some(match (common_from_a, common_from_b) {
            (None, None) => Se3::IDENTITY,
            (None, Some(a_from_b)) => a_from_b,
            (Some(b_from_a), None) => b_from_a.inverse(),
            (Some(common_from_a), Some(common_from_b)) => common_from_a.inverse() * common_from_b,
        })
    }

    /// The motion along a way up to a frame on it; nothing where the way begins there, so that a single step keeps its
    /// bits.
    fn along(&self, way: &[&str], to: &str, time: Timestamp) -> Option<Option<Se3>> {
        let mut to_from_start: Option<Se3> = None;
        for frame in way.iter().take_while(|frame| **frame != to) {
            let edge = self.edges.get(*frame)?;
            let step = if edge.fixed { edge.samples.first()?.1 } else { interpolate(&edge.samples, |s| *s, time)? };
            to_from_start = Some(to_from_start.map_or(step, |so_far| step * so_far));
        }
        Some(to_from_start)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    fn step(parent: &str, child: &str, ms: i64, x: f64, turn: f64) -> StampedTransform {
        StampedTransform {
            stamp: Timestamp(ms * 1_000_000),
            parent: parent.into(),
            child: Some(child.into()),
            parent_from_child: Se3::new(DQuat::from_rotation_z(turn), DVec3::new(x, 0.0, 0.0)),
        }
    }

    #[test]
    fn chains_are_followed_up_and_down_and_interpolated() {
        let moving = [step("map", "base", 0, 1.0, 0.0), step("map", "base", 100, 3.0, 0.0)];
        let fixed =
            [step("base", "/depth", 0, 0.5, std::f64::consts::FRAC_PI_2), step("/base", "colour", 0, 0.25, 0.0)];
        let all = moving.iter().map(|t| (false, t)).chain(fixed.iter().map(|t| (true, t)));
        let frames = Frames::new(all);
        assert_eq!(frames.moving_root("depth"), Some("map"));
        let at = |ms: i64| frames.a_from_b("map", "depth", Timestamp(ms * 1_000_000));
        let origin = |pose: Se3| pose.transform_point(DVec3::ZERO);
        assert!(origin(at(50).unwrap()).abs_diff_eq(DVec3::new(2.5, 0.0, 0.0), 1e-12));
        // Its x axis is the map's y axis.
        assert!(at(0).unwrap().transform_vector(DVec3::X).abs_diff_eq(DVec3::Y, 1e-12));
        assert!(at(115).is_some() && at(121).is_none() && at(-21).is_none());
        // Without a moment's pose between depth and colour: both hang on the same moving frame.
        let colour_from_depth = frames.a_from_b("colour", "depth", Timestamp(i64::MAX)).unwrap();
        assert!(origin(colour_from_depth).abs_diff_eq(DVec3::new(0.25, 0.0, 0.0), 1e-12));
        assert_eq!(frames.a_from_b("colour", "elsewhere", Timestamp(0)), None);
        assert_eq!(frames.times("colour").len(), 2);
    }

    #[test]
    fn a_single_step_keeps_its_bits_and_circles_end() {
        let only = step("colour", "depth", 0, 0.1, 0.3);
        let frames = Frames::new([(false, &only)]);
        assert_eq!(frames.a_from_b("colour", "depth", Timestamp(9)), Some(only.parent_from_child));
        assert_eq!(frames.moving_root("depth"), None);
        let again = step("colour", "depth", 900, 0.1, 0.3);
        let frames = Frames::new([(false, &only), (false, &again)]);
        assert_eq!(frames.a_from_b("colour", "depth", Timestamp(7)), Some(only.parent_from_child));
        assert_eq!(frames.moving_root("depth"), None);
        let circle = [step("a", "b", 0, 0.1, 0.0), step("b", "a", 0, 0.1, 0.0), step("c", "a", 5, 1.0, 0.0)];
        let frames = Frames::new(circle.iter().map(|t| (false, t)));
        assert_eq!(frames.with_two_parents, ["a"]);
        assert!(frames.a_from_b("a", "b", Timestamp(0)).is_some());
    }

    #[test]
    fn long_gaps_have_no_pose_in_their_middle() {
        let frames = [step("w", "c", 0, 0.0, 0.0), step("w", "c", 1000, 1.0, 0.0)];
        let frames = Frames::new(frames.iter().map(|t| (false, t)));
        let at = |ms: i64| frames.a_from_b("w", "c", Timestamp(ms * 1_000_000)).is_some();
        assert!(at(0) && at(15) && at(990) && at(1000));
        assert!(!at(500));
    }
}
