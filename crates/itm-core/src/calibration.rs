//! What is known of the cameras.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::{Distortion, Intrinsics, Se3};

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
    /// The depth camera's lens. Images are undistorted into a pinhole camera's of the same intrinsics before anything else.
    #[serde(default)]
    pub depth_distortion: Distortion,
    /// The colour camera's lens, likewise.
    #[serde(default)]
    pub colour_distortion: Distortion,
}

/// Why a calibration cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
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
    /// A lens whose image folds over, or is nowhere.
    #[error(
        "the {camera} camera's distortion must have finite coefficients under which the image does not fold over, but it \
         does at pixel ({x:.0}, {y:.0})"
    )]
    Distortion {
        /// `depth` or `colour`.
        camera: &'static str,
        /// A pixel where it does; the one nearest to the principal point of those looked at.
        x: f64,
        /// Its row.
        y: f64,
    },
    /// A motion or depth conversion with numbers that cannot be meant.
    #[error("{name} must have finite numbers and a scale that is not zero")]
    Degenerate {
        /// Which part.
        name: &'static str,
    },
}

impl Intrinsics {
    /// Checks that every number can be meant: sides of 1 to 16384 pixels, focal lengths that are finite and not zero (`fx`
    /// positive), a finite principal point. `camera` is what errors call it.
    ///
    /// # Errors
    /// The first number that cannot be.
    pub fn validate(&self, camera: &'static str) -> Result<(), CalibrationError> {
        if !(1..=16384).contains(&self.width) || !(1..=16384).contains(&self.height) {
            return Err(CalibrationError::ImageSize { camera, width: self.width, height: self.height });
        }
        for (name, value) in [("fx", self.fx), ("fy", self.fy)] {
            if !value.is_finite() || value.abs() < 1e-3 {
                return Err(CalibrationError::Value { camera, name, expected: "finite and not zero", value });
            }
        }
        if self.fx < 0.0 {
            return Err(CalibrationError::Value { camera, name: "fx", expected: "positive", value: self.fx });
        }
        for (name, value) in [("cx", self.cx), ("cy", self.cy)] {
            if !value.is_finite() {
                return Err(CalibrationError::Value { camera, name, expected: "finite", value });
            }
        }
        Ok(())
    }
}

impl Calibration {
    /// One camera for both images: registered colour and depth.
    pub const fn registered(camera: Intrinsics, depth_conversion: DepthConversion) -> Self {
        Self {
            depth: camera,
            colour: camera,
            colour_from_depth: Se3::IDENTITY,
            depth_conversion,
            depth_distortion: Distortion::None,
            colour_distortion: Distortion::None,
        }
    }

    /// What a raw depth value is in metres, in the order of operations and the precision in which devices convert; 0 where it
    /// means 'no measurement'.
    pub fn metres(&self, raw: u16) -> f32 {
        if raw == 0 || raw == u16::MAX {
            return 0.0;
        }
        let raw = f32::from(raw);
        match self.depth_conversion {
            DepthConversion::Affine { scale, offset } => raw * scale as f32 + offset as f32,
            DepthConversion::Disparity { a, b } => (8.0 * b * self.depth.fx) as f32 / (a as f32 - raw),
        }
    }

    /// Checks that every number can be meant.
    ///
    /// # Errors
    /// The first number that cannot be.
    pub fn validate(&self) -> Result<(), CalibrationError> {
        let cameras =
            [("depth", &self.depth, &self.depth_distortion), ("colour", &self.colour, &self.colour_distortion)];
        for (camera, i, distortion) in cameras {
            i.validate(camera)?;
            if let Some(pixel) = distortion.fold(i) {
                return Err(CalibrationError::Distortion { camera, x: pixel.x, y: pixel.y });
            }
        }
        let pose = &self.colour_from_depth;
        if Se3::try_from_quaternion(pose.rotation, pose.translation).is_err() {
            return Err(CalibrationError::Degenerate { name: "the motion from depth to colour camera" });
        }
        let usable = match self.depth_conversion {
            DepthConversion::Affine { scale, offset } => scale.is_finite() && scale != 0.0 && offset.is_finite(),
            DepthConversion::Disparity { a, b } => a.is_finite() && b.is_finite() && b != 0.0,
        };
        if usable { Ok(()) } else { Err(CalibrationError::Degenerate { name: "the depth conversion" }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lenses_that_fold_over_are_refused_by_name() {
        let camera = Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5);
        let mild = Distortion::brown([0.1, 0.0, 0.0, 0.0, 0.0]);
        let folding = Distortion::brown([-1.5, 0.0, 0.0, 0.0, 0.0]);
        let good =
            Calibration { colour_distortion: mild, ..Calibration::registered(camera, DepthConversion::MILLIMETRES) };
        assert_eq!(good.validate(), Ok(()));
        let error = Calibration { depth_distortion: folding, ..good }.validate().unwrap_err();
        assert!(matches!(error, CalibrationError::Distortion { camera: "depth", .. }), "{error}");
        let error = Calibration { colour_distortion: folding, ..good }.validate().unwrap_err().to_string();
        assert!(error.contains("colour camera's distortion") && error.contains("at pixel ("), "{error}");
        let infinite = Distortion::brown([f64::INFINITY, 0.0, 0.0, 0.0, 0.0]);
        assert!(Calibration { colour_distortion: infinite, ..good }.validate().is_err());
    }

    #[test]
    fn calibrations_written_before_there_were_lenses_are_read() {
        let camera = "width = 4\nheight = 3\nfx = 5.0\nfy = 5.0\ncx = 1.5\ncy = 1.0\n";
        let pose = "rotation = [0.0, 0.0, 0.0, 1.0]\ntranslation = [0.0, 0.0, 0.0]\n";
        let conversion = "kind = \"affine\"\nscale = 0.001\noffset = 0.0\n";
        let old =
            format!("[depth]\n{camera}[colour]\n{camera}[colour_from_depth]\n{pose}[depth_conversion]\n{conversion}");
        let calibration: Calibration = toml::from_str(&old).unwrap();
        assert!(calibration.depth_distortion.is_none() && calibration.colour_distortion.is_none());
        let lens = "[depth_distortion]\nkind = \"brown\"\nk1 = 0.1\nk2 = 0.0\np1 = 0.0\np2 = 0.0\nk3 = 0.0\n";
        let calibration: Calibration = toml::from_str(&(old + lens)).unwrap();
        assert_eq!(calibration.depth_distortion, Distortion::brown([0.1, 0.0, 0.0, 0.0, 0.0]));
    }
}
