//! How the camera moves through a scene.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use itm_core::Se3;

use crate::walk::{self, look};
use crate::{Cover, Error, Object, SceneName, carried};

/// A way through a scene, as a smooth function of time that goes on after its duration: some go back, the others start
/// again.
///
/// At least four derivatives are continuous, so that gyroscope and accelerometer follow from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Path {
    /// Nearly half a metre to the side past the sofa while turning by 40 degrees, from rest to rest, then back.
    Arc,
    /// Once around the middle of the room looking outwards, ending where it starts.
    Loop,
    /// Standing in the middle, shaking faster and faster until half the time, then calming down. Too fast to track.
    Shake,
    /// The arc and back, with a hand over the lens from 40 to 70 % of the time ([`Cover::WHOLLY`]): what is seen
    /// afterwards was seen before, but the camera is not where it was when the light went out.
    Covered,
    /// A hand in a hurry: around the middle of the room to and fro, up to 1.2 m/s and 120 degrees/s, ending where it
    /// starts. From frame to frame it moves by no more than 4 cm
    /// and 4 degrees at 30 Hz.
    Fast,
    /// From one furnished end of [`Scene::wall`](crate::Scene::wall) along its bare wall to the other end, then back.
    /// For a good third of the time nothing but the wall is in view: depth says nothing about motion along it.
    Wall,
    /// Through [`Scene::hall`](crate::Scene::hall) past the dining table, around it with half a turn, and back on its
    /// other side, from rest to rest; then the same way back. Much of what is seen is 3 to 6 m away.
    Hall,
    /// Along [`Scene::corridor`](crate::Scene::corridor) to its end, a turn on the spot, back to its beginning and another
    /// turn: 53 m from rest to rest, ending where it starts. The way back shows everything from the other side.
    Corridor,
    /// A figure of eight around the tables of [`Scene::two_rooms`](crate::Scene::two_rooms): 20 m, through the passage
    /// twice, across its own way, ending where it starts.
    Eight,
    /// Through [`Scene::rooms`](crate::Scene::rooms) one after the other, looking around in each in the same way, from
    /// rest in the first to rest in the last; then the same way back.
    Rooms,
    /// Looking around at one place in the room, then at another, 1 m away and turned by more than 120 degrees. There the
    /// lens is covered, and free again when the camera is back where it started: a place seen before that is too far away
    /// from the last one seen to be found by searching around it. From rest to rest, ending where it starts.
    Kidnapped,
    /// Standing in the room, swaying a little, with a box on the floor in view, which somebody lifts and carries out of view from
    /// 30 to 60 % of the time ([`Path::carried`]). It stands there again in each repetition.
    Carried,
}

impl Path {
    /// Every path.
    pub const ALL: [Self; 12] = [
        Self::Arc,
        Self::Loop,
        Self::Shake,
        Self::Covered,
        Self::Fast,
        Self::Wall,
        Self::Hall,
        Self::Corridor,
        Self::Eight,
        Self::Rooms,
        Self::Kidnapped,
        Self::Carried,
    ];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Arc => "arc",
            Self::Loop => "loop",
            Self::Shake => "shake",
            Self::Covered => "covered",
            Self::Fast => "fast",
            Self::Wall => "wall",
            Self::Hall => "hall",
            Self::Corridor => "corridor",
            Self::Eight => "eight",
            Self::Rooms => "rooms",
            Self::Kidnapped => "kidnapped",
            Self::Carried => "carried",
        }
    }

    /// Seconds that the path takes at the speed of a calm hand: at most 0.5 m/s and 40 degrees/s, but for
    /// [`Path::Shake`], which is meant to be too fast (up to 0.5 m/s and 200 degrees/s), [`Path::Fast`] (up to 1.2 m/s
    /// and 120 degrees/s), and those where somebody walks ([`Path::Hall`], [`Path::Corridor`], [`Path::Eight`],
    /// [`Path::Rooms`]: up to 0.8 m/s).
    pub fn default_duration_s(self) -> f64 {
        match self {
            Self::Arc => 2.0,
            Self::Loop => 15.0,
            Self::Shake | Self::Covered => 4.0,
            Self::Fast => 12.0,
            Self::Wall => 10.0,
            Self::Hall => 20.0,
            Self::Corridor => 96.0,
            Self::Eight => 40.0,
            Self::Rooms => 90.0,
            Self::Kidnapped => 18.0,
            Self::Carried => 8.0,
        }
    }

    /// The scenes that the path leads through, the usual one first.
    pub fn scenes(self) -> &'static [SceneName] {
        match self {
            Self::Arc | Self::Loop | Self::Shake | Self::Covered | Self::Fast | Self::Kidnapped | Self::Carried => {
                &[SceneName::Room]
            }
            Self::Wall => &[SceneName::Wall, SceneName::BlankWall],
            Self::Hall => &[SceneName::Hall],
            Self::Corridor => &[SceneName::Corridor],
            Self::Eight => &[SceneName::TwoRooms],
            Self::Rooms => &[SceneName::Rooms],
        }
    }

    /// The scene that the path is made for.
    pub fn scene(self) -> SceneName {
        self.scenes()[0]
    }

    /// Pose at a time in seconds, for a path that takes `duration_s`.
    pub fn world_from_camera(self, time_s: f64, duration_s: f64) -> Se3 {
        let turn = time_s / duration_s;
        // From 0 at rest to 1 at rest, and back.
        let along = 0.5 - 0.5 * (PI * turn).cos();
        let a = TAU * turn;
        match self {
            Self::Arc => arc(along),
            Self::Covered => arc(0.5 - 0.5 * a.cos()),
            Self::Loop => {
                let position = DVec3::new(0.6 * a.sin(), -1.35 + 0.06 * (3.0 * a).sin(), 0.4 * a.cos());
                let pitch = -0.22 + 0.1 * (2.0 * a + 0.4).sin();
                look(position, a + 0.08 * (2.0 * a).sin(), pitch, 0.05 * (3.0 * a + 1.0).sin())
            }
            Self::Shake => {
                // In real time, so that a longer recording shakes longer rather than more slowly.
                let strength = (PI * turn).sin().powi(2);
                let wave = |hz: f64, phase: f64| strength * (TAU * hz * time_s + phase).sin();
                let position = DVec3::new(-0.1, -1.35, -0.35)
                    + DVec3::new(0.03 * wave(1.7, 0.0), 0.02 * wave(2.1, 1.0), 0.025 * wave(1.3, 2.0));
                look(position, 0.1 + 0.22 * wave(2.0, 0.5), -0.2 + 0.1 * wave(1.6, 1.5), 0.06 * wave(1.1, 0.2))
            }
            Self::Fast => {
                // The camera's place turns within the free ellipse, now faster, now slower; its gaze sweeps around once.
                let place = 3.0 * a + 0.2 * (4.0 * a).sin();
                let out = 0.82 + 0.16 * (5.0 * a + 0.5).sin();
                let height = 1.425 + 0.08 * (7.0 * a).sin() + 0.05 * (4.0 * a + 1.0).sin();
                let position = DVec3::new(0.6 * out * place.sin(), -height, 0.45 * out * place.cos());
                let yaw = a + 0.42 * (5.0 * a).sin() + 0.08 * (9.0 * a + 2.0).sin();
                look(position, yaw, -0.22 + 0.13 * (6.0 * a + 0.4).sin(), 0.12 * (5.0 * a + 1.0).sin())
            }
            Self::Wall => {
                let from_middle = 2.0 * along - 1.0;
                let ends = from_middle * from_middle;
                let position = DVec3::new(1.5 * from_middle, -1.3, 0.8 - 0.6 * ends);
                look(position, 1.05 * from_middle * ends, -0.2 * ends, 0.04 * (TAU * along).sin())
            }
            Self::Hall => {
                let around = PI * along;
                let height = 1.4 + 0.05 * (5.0 * around).sin();
                let position = DVec3::new(-1.8 + 4.2 * around.sin(), -height, -1.7 * around.cos());
                let pitch = -0.2 + 0.05 * (3.0 * around).sin();
                look(position, 1.4 - 2.9 * along, pitch, 0.02 * (4.0 * around).sin())
            }
            Self::Corridor => walk::corridor(turn.rem_euclid(1.0)),
            Self::Eight => walk::eight(a),
            Self::Rooms => walk::rooms(1.0 - (turn.rem_euclid(2.0) - 1.0).abs()),
            Self::Kidnapped => walk::kidnapped(turn.rem_euclid(1.0)),
            Self::Carried => {
                let sway = |times: f64, phase: f64| (times * a + phase).sin();
                let position = DVec3::new(0.3, -1.4, -0.1)
                    + DVec3::new(0.04 * sway(2.0, 0.0), 0.02 * sway(3.0, 1.0), 0.03 * sway(1.0, 2.0));
                look(position, -1.57 + 0.05 * sway(2.0, 0.5), -0.55 + 0.03 * sway(3.0, 1.5), 0.02 * sway(1.0, 0.2))
            }
        }
    }

    /// What is carried through the scene at a time in seconds, for a path that takes `duration_s`: objects beside the scene's own.
    pub fn carried(self, time_s: f64, duration_s: f64) -> Vec<Object> {
        match self {
            Self::Carried => carried::carton((time_s / duration_s).rem_euclid(1.0)),
            _ => Vec::new(),
        }
    }

    /// Pose of what [`Path::carried`] gives, if it gives anything: its origin is the middle of the bottom, y points down.
    pub fn world_from_carried(self, time_s: f64, duration_s: f64) -> Option<Se3> {
        (self == Self::Carried).then(|| carried::world_from_box((time_s / duration_s).rem_euclid(1.0)))
    }

    /// What the path has over the lens, if anything.
    pub fn cover(self) -> Option<Cover> {
        match self {
            Self::Covered => Some(Cover::WHOLLY),
            Self::Kidnapped => Some(Cover { during: walk::KIDNAPPED_DURING, ..Cover::WHOLLY }),
            _ => None,
        }
    }
}

/// Along the arc, from 0 to 1.
fn arc(along: f64) -> Se3 {
    let position = DVec3::new(-0.33 + 0.46 * along, -1.35 + 0.05 * (PI * along).sin(), -0.15 - 0.1 * along);
    look(position, -0.4 + 0.7 * along, -0.28 + 0.08 * along, 0.03 * (PI * along).sin())
}

impl fmt::Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Path {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|p| p.name() == name).ok_or_else(|| Error::UnknownPath { found: name.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rooms::PITCH_M;

    /// Largest speeds in m/s and rad/s over a path.
    fn speeds(path: Path) -> (f64, f64) {
        let (duration, step) = (path.default_duration_s(), 1e-3);
        let mut largest = (0.0f64, 0.0f64);
        let mut time = 0.0;
        while time < duration {
            let [a, b] = [time, time + step].map(|t| path.world_from_camera(t, duration));
            largest.0 = largest.0.max((b.translation - a.translation).length() / step);
            largest.1 = largest.1.max((a.inverse() * b).angle() / step);
            time += step;
        }
        largest
    }

    #[test]
    fn speeds_are_what_each_path_promises() {
        for (path, m_per_s, degrees_per_s) in [
            (Path::Arc, 0.15..=0.4, 20.0..=40.0),
            (Path::Loop, 0.15..=0.4, 20.0..=40.0),
            (Path::Covered, 0.15..=0.4, 20.0..=40.0),
            (Path::Wall, 0.3..=0.5, 20.0..=40.0),
            (Path::Hall, 0.5..=0.8, 10.0..=25.0),
            (Path::Shake, 0.3..=0.5, 150.0..=200.0),
            (Path::Fast, 1.0..=1.2, 100.0..=120.0),
            (Path::Corridor, 0.6..=0.8, 30.0..=50.0),
            (Path::Eight, 0.7..=0.8, 10.0..=40.0),
            (Path::Rooms, 0.5..=0.8, 30.0..=50.0),
            (Path::Kidnapped, 0.3..=0.5, 30.0..=50.0),
            (Path::Carried, 0.04..=0.1, 3.0..=10.0),
        ] {
            let (linear, angular) = speeds(path);
            assert!(m_per_s.contains(&linear), "{path}: {linear} m/s");
            assert!(degrees_per_s.contains(&angular.to_degrees()), "{path}: {} degrees/s", angular.to_degrees());
        }
    }

    #[test]
    fn a_hand_in_a_hurry_stays_in_the_rooms_free_space() {
        let d = Path::Fast.default_duration_s();
        for i in 0..1000 {
            let p = Path::Fast.world_from_camera(d * f64::from(i) / 1000.0, d).translation;
            assert!((p.x / 0.6).powi(2) + (p.z / 0.45).powi(2) <= 1.0 && (-1.6..=-1.25).contains(&p.y), "{p}");
        }
    }

    #[test]
    fn poses_accelerations_and_turning_rates_have_no_jumps() {
        for path in Path::ALL {
            let duration = path.default_duration_s();
            let step = 1e-3;
            // Past the end, where the path repeats.
            let samples: Vec<_> = (0..(1.3 * duration / step) as usize)
                .map(|i| crate::inertial::motion(path, i as f64 * step, duration))
                .collect();
            for pair in samples.windows(2) {
                let jump = (pair[1].acceleration_world - pair[0].acceleration_world).length();
                assert!(jump < 0.2, "{path}: the acceleration jumps by {jump} m/s²");
                let jump = (pair[1].angular_velocity_camera - pair[0].angular_velocity_camera).length();
                assert!(jump < 0.1, "{path}: the turning rate jumps by {jump} rad/s");
            }
        }
    }

    #[test]
    fn closed_paths_close() {
        let closed = [Path::Loop, Path::Covered, Path::Shake, Path::Fast, Path::Corridor, Path::Eight, Path::Kidnapped];
        for path in closed.into_iter().chain([Path::Carried]) {
            let d = path.default_duration_s();
            let gap = path.world_from_camera(0.0, d).inverse() * path.world_from_camera(d, d);
            assert!(gap.translation.length() < 1e-9 && gap.angle() < 1e-9, "{path}");
        }
    }

    #[test]
    fn the_camera_keeps_away_from_surfaces() {
        for path in Path::ALL {
            // A corridor and the openings between rooms are narrow.
            let nearest = if matches!(path, Path::Corridor | Path::Eight | Path::Rooms) { 0.4 } else { 0.6 };
            for scene in path.scenes() {
                let (scene, d) = (scene.scene(), path.default_duration_s());
                for i in 0..500 {
                    let at = path.world_from_camera(d * f64::from(i) / 500.0, d).translation.as_vec3();
                    let clearance = scene.distance(at);
                    assert!(clearance >= nearest, "{path}: {clearance} m at {at}");
                }
            }
        }
    }

    #[test]
    fn walks_are_as_long_as_they_say() {
        for (path, metres) in [
            (Path::Hall, 8.0..14.0),
            (Path::Corridor, 53.0..55.0),
            (Path::Eight, 19.0..21.0),
            (Path::Rooms, 33.0..35.0),
        ] {
            let d = path.default_duration_s();
            let at = |i: i32| path.world_from_camera(d * f64::from(i) / 1000.0, d).translation;
            let length: f64 = (0..1000).map(|i| at(i).distance(at(i + 1))).sum();
            assert!(metres.contains(&length), "{path}: {length} m");
        }
    }

    #[test]
    fn walks_start_and_end_at_rest_where_they_say_so() {
        for path in [Path::Corridor, Path::Rooms, Path::Kidnapped] {
            let d = path.default_duration_s();
            for (from, to) in [(0.0, 0.1), (d - 0.1, d)] {
                let moved = path.world_from_camera(from, d).inverse() * path.world_from_camera(to, d);
                assert!(moved.translation.length() < 1e-4 && moved.angle() < 1e-4, "{path} moves from {from} s");
            }
        }
    }

    #[test]
    fn the_eight_crosses_its_own_way_in_another_direction() {
        let d = Path::Eight.default_duration_s();
        let [there, back] = [0.0, 0.5].map(|share| Path::Eight.world_from_camera(share * d, d));
        assert!(there.translation.distance(back.translation) < 0.05);
        assert!((there.inverse() * back).angle().to_degrees() > 60.0);
    }

    #[test]
    fn who_is_kidnapped_wakes_far_away_at_a_place_seen_before() {
        let (path, d) = (Path::Kidnapped, Path::Kidnapped.default_duration_s());
        let during = path.cover().unwrap().during;
        let [last, woken] = during.map(|share| path.world_from_camera(share * d, d));
        let carried = last.inverse() * woken;
        assert!(carried.translation.length() > 1.0, "{} m", carried.translation.length());
        assert!(carried.angle().to_degrees() > 120.0, "{} degrees", carried.angle().to_degrees());
        let seen_before = (0..1000).map(|i| during[0] * d * f64::from(i) / 1000.0).any(|time_s| {
            let apart = path.world_from_camera(time_s, d).inverse() * woken;
            apart.translation.length() < 0.15 && apart.angle().to_degrees() < 15.0
        });
        assert!(seen_before);
    }

    #[test]
    fn each_room_is_visited_in_the_same_way() {
        let d = Path::Rooms.default_duration_s();
        let poses: Vec<_> = (0..9000).map(|i| Path::Rooms.world_from_camera(d * f64::from(i) / 9000.0, d)).collect();
        // Poses on the way through the fifth room, and where they are in the others.
        let of_fifth = poses.iter().filter(|p| (p.translation.x + 0.5 * f64::from(PITCH_M)).abs() < 1.2);
        for pose in of_fifth.step_by(50) {
            for rooms_on in [-3.0, 2.0, 4.0] {
                let there = pose.translation + DVec3::X * rooms_on * f64::from(PITCH_M);
                let nearest = poses
                    .iter()
                    .map(|p| (p.translation.distance(there), (p.inverse() * *pose).angle().to_degrees()))
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap();
                assert!(nearest.0 < 0.05 && nearest.1 < 4.0, "{nearest:?} of {there}");
            }
        }
    }

    #[test]
    fn the_hall_turns_by_half_a_turn() {
        let (path, d) = (Path::Hall, Path::Hall.default_duration_s());
        let at = |share: f64| path.world_from_camera(share * d, d);
        let turned = (at(0.0).inverse() * at(1.0)).angle().to_degrees();
        assert!((150.0..=180.0).contains(&turned), "{turned} degrees");
    }

    #[test]
    fn names_read_back() {
        for path in Path::ALL {
            assert_eq!(path.to_string().parse::<Path>().unwrap(), path);
        }
        let error = "spiral".parse::<Path>().unwrap_err().to_string();
        assert!(error.contains("spiral") && error.contains("covered"), "{error}");
    }
}
