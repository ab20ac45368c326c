//! What a gyroscope and an accelerometer fixed to the camera read.

use glam::DVec3;
use itm_core::Timestamp;
use rand::SeedableRng;
use rand_pcg::Pcg32;

use crate::Path;
use crate::random::{Stream, gaussian};

/// Acceleration of a falling body in the world's axes (y down), in m/s².
pub const GRAVITY_WORLD: DVec3 = DVec3::new(0.0, 9.81, 0.0);

/// Readings of a gyroscope and an accelerometer at one moment, in the camera's axes (x right, y down, z forward).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialReading {
    /// When, by the same clock as the frames.
    pub timestamp: Timestamp,
    /// Angular velocity in rad/s.
    pub gyroscope: DVec3,
    /// Specific force in m/s²: acceleration less gravity, about (0, -9.81, 0) for a level camera at rest.
    pub accelerometer: DVec3,
}

/// Errors of the inertial sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialNoise {
    /// Constant error of the gyroscope in rad/s.
    pub gyroscope_bias: DVec3,
    /// Standard deviation of a gyroscope's reading in rad/s, for each axis.
    pub gyroscope_sigma: f64,
    /// Constant error of the accelerometer in m/s².
    pub accelerometer_bias: DVec3,
    /// Standard deviation of an accelerometer's reading in m/s², for each axis.
    pub accelerometer_sigma: f64,
}

impl InertialNoise {
    /// About what the sensors of a telephone do at 200 Hz.
    pub const PHONE: Self = Self {
        gyroscope_bias: DVec3::new(0.004, -0.003, 0.002),
        gyroscope_sigma: 0.002,
        accelerometer_bias: DVec3::new(0.05, -0.03, 0.04),
        accelerometer_sigma: 0.02,
    };

    /// Reading number `index` with these errors; the same for the same seed and number.
    pub(crate) fn apply(&self, reading: InertialReading, seed: u64, index: u64) -> InertialReading {
        let mut random = Pcg32::seed_from_u64(Stream::Inertial.seed(seed, index));
        let mut noise = || DVec3::from_array(std::array::from_fn(|_| gaussian(&mut random)));
        InertialReading {
            timestamp: reading.timestamp,
            gyroscope: reading.gyroscope + self.gyroscope_bias + self.gyroscope_sigma * noise(),
            accelerometer: reading.accelerometer + self.accelerometer_bias + self.accelerometer_sigma * noise(),
        }
    }
}

/// First and second derivatives of a path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    /// In rad/s.
    pub(crate) angular_velocity_camera: DVec3,
    /// In m/s².
    pub(crate) acceleration_world: DVec3,
}

/// Derivatives by central differences: their errors, below 1e-7 rad/s and 1e-6 m/s² on these paths, are far below any
/// sensor's.
pub(crate) fn motion(path: Path, time_s: f64, duration_s: f64) -> Motion {
    let at = |dt: f64| path.world_from_camera(time_s + dt, duration_s);
    let h = 1e-5;
    let [.., x, y, z] = (at(-h).inverse() * at(h)).log();
    // The fourth-order stencil of the second derivative.
    let h2 = 1e-3;
    let p = |k: f64| at(k * h2).translation;
    let second = -p(-2.0) + 16.0 * p(-1.0) - 30.0 * p(0.0) + 16.0 * p(1.0) - p(2.0);
    Motion { angular_velocity_camera: DVec3::new(x, y, z) / (2.0 * h), acceleration_world: second / (12.0 * h2 * h2) }
}

/// What ideal sensors read `time_s` after the start of a path.
pub(crate) fn reading(path: Path, time_s: f64, duration_s: f64, timestamp: Timestamp) -> InertialReading {
    let motion = motion(path, time_s, duration_s);
    let camera_from_world = path.world_from_camera(time_s, duration_s).rotation.conjugate();
    InertialReading {
        timestamp,
        gyroscope: motion.angular_velocity_camera,
        accelerometer: camera_from_world * (motion.acceleration_world - GRAVITY_WORLD),
    }
}
