//! What a camera delivers at one moment.

use std::fmt;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::{ColourImage, Image, Se3};

/// A moment, in nanoseconds since an origin that the recording chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Timestamp(pub i64);

impl Timestamp {
    /// The nearest nanosecond to a number of seconds.
    pub fn from_secs_f64(seconds: f64) -> Self {
        Self((seconds * 1e9).round() as i64)
    }

    /// In seconds. Exact to about 0.2 microseconds for times since 1970.
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}

impl fmt::Display for Timestamp {
    /// Seconds with nine decimals, without going through floating point.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.0 < 0 { "-" } else { "" };
        let ns = self.0.unsigned_abs();
        write!(f, "{sign}{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000)
    }
}

/// A depth image as it comes from a sensor or a file.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthImage {
    /// Raw sensor values; the calibration's [`crate::DepthConversion`] says what they mean.
    Raw(Image<u16>),
    /// Metres along the optical axis; values that are not positive and finite mean 'no measurement'.
    Metres(Image<f32>),
}

impl DepthImage {
    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        match self {
            Self::Raw(image) => image.size(),
            Self::Metres(image) => image.size(),
        }
    }
}

/// A gyroscope's reading.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AngularRate {
    /// When, by the depth camera's clock.
    pub timestamp: Timestamp,
    /// Angular velocity in rad/s, in the sensor's axes.
    pub rad_per_s: DVec3,
}

/// What a camera delivers at one moment: depth, perhaps colour, and a pose where the recording knows one.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Number of the frame within its recording, from 0; frames that could not be read leave gaps.
    pub index: u64,
    /// When it was taken (by the depth camera's clock).
    pub timestamp: Timestamp,
    /// Depth.
    pub depth: DepthImage,
    /// Colour, where there is any. It may have another size than depth.
    pub colour: Option<ColourImage>,
    /// When the colour image was taken, by the same clock; `None` where the recording does not say, which counts as at the
    /// same time as depth.
    pub colour_timestamp: Option<Timestamp>,
    /// The recording's own pose of the depth camera, where it has one.
    pub world_from_camera: Option<Se3>,
    /// A gyroscope's readings since the frame before, in the order of time, where there is such a sensor.
    pub gyroscope: Vec<AngularRate>,
    /// The orientation that an inertial sensor gives, where there is one: takes the sensor's directions to those of a fixed
    /// frame.
    pub imu_orientation: Option<DQuat>,
}

impl Frame {
    /// A frame of depth, and colour if any, with nothing else known.
    pub fn new(index: u64, timestamp: Timestamp, depth: DepthImage, colour: Option<ColourImage>) -> Self {
        Self {
            index,
            timestamp,
            depth,
            colour,
            colour_timestamp: None,
            world_from_camera: None,
            gyroscope: Vec::new(),
            imu_orientation: None,
        }
    }

    /// The same at a pose.
    pub fn at_pose(mut self, world_from_camera: Se3) -> Self {
        self.world_from_camera = Some(world_from_camera);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timestamps_print_every_digit() {
        assert_eq!(Timestamp(1_305_031_229_528_748_000).to_string(), "1305031229.528748000");
        assert_eq!(Timestamp(-1_500_000_000).to_string(), "-1.500000000");
        assert_eq!(Timestamp::from_secs_f64(0.25), Timestamp(250_000_000));
    }
}
