//! How the camera moves through the room.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::str::FromStr;

use glam::{DQuat, DVec3};
use itm_core::Se3;

use crate::Error;

/// A way through [`Scene::room`](crate::Scene::room), as a smooth function of time that goes on after its duration: the
/// arc goes back, the others start again.
///
/// All derivatives exist, so that gyroscope and accelerometer follow from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Path {
    /// Nearly half a metre to the side past the sofa while turning by 40 degrees, from rest to rest.
    Arc,
    /// Once around the middle of the room looking outwards, ending where it starts.
    Loop,
    /// Standing in the middle, shaking faster and faster until half the time, then calming down.
    Shake,
    /// The arc and back, with a hand over the lens from 40 to 70 % of the time: what is seen afterwards was seen
    /// before, but the camera is not where it was when the light went out.
    Covered,
}

impl Path {
    /// Every path.
    pub const ALL: [Self; 4] = [Self::Arc, Self::Loop, Self::Shake, Self::Covered];

    /// The name that [`FromStr`] reads.
    pub fn name(self) -> &'static str {
        match self {
            Self::Arc => "arc",
            Self::Loop => "loop",
            Self::Shake => "shake",
            Self::Covered => "covered",
        }
    }

    /// Seconds that the path takes at the speed of a calm hand: at most 0.4 m/s and 40 degrees/s, but for
    /// [`Path::Shake`], which is meant to be too fast (up to 0.5 m/s and 200 degrees/s).
    pub fn default_duration_s(self) -> f64 {
        match self {
            Self::Arc => 2.0,
            Self::Loop => 15.0,
            Self::Shake | Self::Covered => 4.0,
        }
    }

    /// Pose at a time in seconds, for a path that takes `duration_s`.
    pub fn world_from_camera(self, time_s: f64, duration_s: f64) -> Se3 {
        let turn = time_s / duration_s;
        match self {
            Self::Arc => arc(0.5 - 0.5 * (PI * turn).cos()),
            Self::Covered => arc(0.5 - 0.5 * (TAU * turn).cos()),
            Self::Loop => {
                let a = TAU * turn;
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
        }
    }

    /// Whether the lens is covered at a time.
    pub fn covered(self, time_s: f64, duration_s: f64) -> bool {
        self == Self::Covered && (0.4..0.7).contains(&(time_s / duration_s).rem_euclid(1.0))
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
    use crate::Scene;

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
    fn speeds_are_those_of_a_hand() {
        for path in [Path::Arc, Path::Loop, Path::Covered] {
            let (linear, angular) = speeds(path);
            assert!((0.15..=0.4).contains(&linear), "{path}: {linear} m/s");
            assert!((20.0..=40.0).contains(&angular.to_degrees()), "{path}: {} degrees/s", angular.to_degrees());
        }
        let (linear, angular) = speeds(Path::Shake);
        assert!((0.3..=0.5).contains(&linear), "{linear} m/s");
        assert!((150.0..=200.0).contains(&angular.to_degrees()), "{} degrees/s", angular.to_degrees());
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
        for path in [Path::Loop, Path::Covered, Path::Shake] {
            let d = path.default_duration_s();
            let gap = path.world_from_camera(0.0, d).inverse() * path.world_from_camera(d, d);
            assert!(gap.translation.length() < 1e-9 && gap.angle() < 1e-9, "{path}");
        }
    }

    #[test]
    fn the_camera_keeps_away_from_surfaces() {
        let room = Scene::room();
        for path in Path::ALL {
            let d = path.default_duration_s();
            for i in 0..500 {
                let at = path.world_from_camera(d * f64::from(i) / 500.0, d).translation.as_vec3();
                let clearance = room.distance(at);
                assert!(clearance >= 0.6, "{path}: {clearance} m at {at}");
            }
        }
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
