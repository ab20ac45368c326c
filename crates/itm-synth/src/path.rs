//! How the camera moves through a scene.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use glam::{DQuat, DVec3};
use itm_core::Se3;

use crate::{Cover, Error, SceneName};

/// A way through a scene, as a smooth function of time that goes on after its duration: some go back, the others start
/// again.
///
/// All derivatives exist, so that gyroscope and accelerometer follow from it.
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
}

impl Path {
    /// Every path.
    pub const ALL: [Self; 7] = [Self::Arc, Self::Loop, Self::Shake, Self::Covered, Self::Fast, Self::Wall, Self::Hall];

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
        }
    }

    /// Seconds that the path takes at the speed of a calm hand: at most 0.5 m/s and 40 degrees/s, but for
    /// [`Path::Shake`], which is meant to be too fast (up to 0.5 m/s and 200 degrees/s), [`Path::Fast`] (up to 1.2 m/s
    /// and 120 degrees/s), and [`Path::Hall`], where somebody walks (up to 0.8 m/s).
    pub fn default_duration_s(self) -> f64 {
        match self {
            Self::Arc => 2.0,
            Self::Loop => 15.0,
            Self::Shake | Self::Covered => 4.0,
            Self::Fast => 12.0,
            Self::Wall => 10.0,
            Self::Hall => 20.0,
        }
    }

    /// The scenes that the path leads through, the usual one first.
    pub fn scenes(self) -> &'static [SceneName] {
        match self {
            Self::Arc | Self::Loop | Self::Shake | Self::Covered | Self::Fast => &[SceneName::Room],
            Self::Wall => &[SceneName::Wall, SceneName::BlankWall],
            Self::Hall => &[SceneName::Hall],
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
        }
    }

    /// What the path has over the lens, if anything.
    pub fn cover(self) -> Option<Cover> {
        (self == Self::Covered).then_some(Cover::WHOLLY)
    }
}

/// Along the arc, from 0 to 1.
fn arc(along: f64) -> Se3 {
    let position = DVec3::new(-0.33 + 0.46 * along, -1.35 + 0.05 * (PI * along).sin(), -0.15 - 0.1 * along);
    look(position, -0.4 + 0.7 * along, -0.28 + 0.08 * along, 0.03 * (PI * along).sin())
}

/// A camera at a position that looks along +z turned by `yaw` to the right, then by `pitch` upwards, and is then
/// rolled clockwise by `roll`.
fn look(position: DVec3, yaw: f64, pitch: f64, roll: f64) -> Se3 {
    let rotation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch) * DQuat::from_rotation_z(roll);
    Se3::new(rotation, position)
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
        for path in [Path::Loop, Path::Covered, Path::Shake, Path::Fast] {
            let d = path.default_duration_s();
            let gap = path.world_from_camera(0.0, d).inverse() * path.world_from_camera(d, d);
            assert!(gap.translation.length() < 1e-9 && gap.angle() < 1e-9, "{path}");
        }
    }

    #[test]
    fn the_camera_keeps_away_from_surfaces() {
        for path in Path::ALL {
            for scene in path.scenes() {
                let (scene, d) = (scene.scene(), path.default_duration_s());
                for i in 0..500 {
                    let at = path.world_from_camera(d * f64::from(i) / 500.0, d).translation.as_vec3();
                    let clearance = scene.distance(at);
                    assert!(clearance >= 0.6, "{path}: {clearance} m at {at}");
                }
            }
        }
    }

    #[test]
    fn the_hall_is_long_and_turns_by_half_a_turn() {
        let (path, d) = (Path::Hall, Path::Hall.default_duration_s());
        let at = |share: f64| path.world_from_camera(share * d, d);
        let length: f64 = (0..200)
            .map(|i| at(f64::from(i) / 200.0).translation.distance(at(f64::from(i + 1) / 200.0).translation))
            .sum();
        assert!((8.0..14.0).contains(&length), "{length} m");
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
