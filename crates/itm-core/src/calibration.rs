//! What is known of the cameras.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Intrinsics, Se3};

/// How a raw depth value becomes metres along the optical axis. Raw 0 and 65535 always mean 'no measurement'.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum DepthConversion {
    /// `depth = raw * scale + offset`.
    Affine {
        /// Metres for each raw step.
        scale: f64,
        /// Metres.
        offset: f64,
    },
    /// Kinect disparities: `depth = 8 b fx / (a - raw)` with `fx` of the depth camera (the report's calibration file).
    Disparity {
        /// Raw value at infinity.
        a: f64,
        /// Baseline in metres.
        b: f64,
    },
}

impl DepthConversion {
    /// Millimetres, as most sensors and 7-Scenes store them.
    pub const MILLIMETRES: Self = Self::Affine { scale: 0.001, offset: 0.0 };
    /// 5000 steps for a metre, as in TUM RGB-D and ICL-NUIM.
    pub const TUM: Self = Self::Affine { scale: 1.0 / 5000.0, offset: 0.0 };
}

/// What is known of a depth camera and the colour camera beside it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// The depth camera.
    pub depth: Intrinsics,
    /// The colour camera; equal to `depth` for registered images.
    pub colour: Intrinsics,
    /// Takes depth-camera coordinates to colour-camera coordinates; the identity for registered images.
    pub colour_from_depth: Se3,
    /// Meaning of raw depth values.
    pub depth_conversion: DepthConversion,
}

/// Why a calibration cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CalibrationError {
    /// An image without pixels, or too large to index.
    #[error("the {camera} camera's image size must be between 1x1 and 16384x16384, not {width}x{height}")]
    ImageSize {
        /// `depth` or `colour`.
        camera: &'static str,
        /// Width found.
        width: u32,
        /// Height found.
        height: u32,
    },
    /// A focal length of zero, or a number that is not finite.
    #[error("the {camera} camera's {name} must be {expected}, not {value}")]
    Value {
        /// `depth` or `colour`.
        camera: &'static str,
        /// Which number.
        name: &'static str,
        /// What would do.
        expected: &'static str,
        /// What was found.
        value: f64,
    },
    /// A motion or depth conversion with numbers that cannot be meant.
    #[error("{name} must have finite numbers and a scale that is not zero")]
    Degenerate {
        /// Which part.
        name: &'static str,
    },
}

impl Calibration {
    /// One camera for both images: registered colour and depth.
    pub const fn registered(camera: Intrinsics, depth_conversion: DepthConversion) -> Self {
        Self { depth: camera, colour: camera, colour_from_depth: Se3::IDENTITY, depth_conversion }
    }

    /// Checks that every number can be meant.
    ///
    /// # Errors
    /// The first number that cannot be.
    pub fn validate(&self) -> Result<(), CalibrationError> {
        for (camera, i) in [("depth", &self.depth), ("colour", &self.colour)] {
            if !(1..=16384).contains(&i.width) || !(1..=16384).contains(&i.height) {
                return Err(CalibrationError::ImageSize { camera, width: i.width, height: i.height });
            }
            for (name, value) in [("fx", i.fx), ("fy", i.fy)] {
                if !value.is_finite() || value.abs() < 1e-3 {
                    return Err(CalibrationError::Value { camera, name, expected: "finite and not zero", value });
                }
            }
            if i.fx < 0.0 {
                return Err(CalibrationError::Value { camera, name: "fx", expected: "positive", value: i.fx });
            }
            for (name, value) in [("cx", i.cx), ("cy", i.cy)] {
                if !value.is_finite() {
                    return Err(CalibrationError::Value { camera, name, expected: "finite", value });
                }
            }
        }
        if !self.colour_from_depth.is_finite() {
            return Err(CalibrationError::Degenerate { name: "the motion from depth to colour camera" });
        }
        let usable = match self.depth_conversion {
            DepthConversion::Affine { scale, offset } => scale.is_finite() && scale != 0.0 && offset.is_finite(),
            DepthConversion::Disparity { a, b } => a.is_finite() && b.is_finite() && b != 0.0,
        };
        if usable { Ok(()) } else { Err(CalibrationError::Degenerate { name: "the depth conversion" }) }
    }
}
