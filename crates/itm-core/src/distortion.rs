//! Lens distortion.

use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};

use crate::Intrinsics;

/// How a lens bends the image of a pinhole camera.
///
/// With `(x, y) = (X / Z, Y / Z)` the normalised point that a pinhole camera sees, and `r² = x² + y²`, the lens shows it
/// at
///
/// ```text
/// x' = x f + 2 p1 x y + p2 (r² + 2 x²)        f = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
/// y' = y f + p1 (r² + 2 y²) + 2 p2 x y
/// ```
///
/// and the pixel is `(fx x' + cx, fy y' + cy)`. The polynomial with the tangential terms is Brown's (1966, *Decentering
/// Distortion of Lenses*; 1971, *Close-Range Camera Calibration*) after Conrady; the rational factor follows Claus &
/// Fitzgibbon (2005, *A Rational Function Lens Distortion Model for General Cameras*) in the form that OpenCV's
/// documentation gives it. Coefficients have OpenCV's names and order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Distortion {
    /// A pinhole camera, or an image that is undistorted already.
    #[default]
    None,
    /// Brown and Conrady's polynomial: `k4 = k5 = k6 = 0`.
    Brown {
        /// Radial, of r².
        k1: f64,
        /// Radial, of r⁴.
        k2: f64,
        /// Tangential.
        p1: f64,
        /// Tangential.
        p2: f64,
        /// Radial, of r⁶.
        k3: f64,
    },
    /// The rational model of eight coefficients.
    Rational {
        /// Of r² in the numerator.
        k1: f64,
        /// Of r⁴ in the numerator.
        k2: f64,
        /// Tangential.
        p1: f64,
        /// Tangential.
        p2: f64,
        /// Of r⁶ in the numerator.
        k3: f64,
        /// Of r² in the denominator.
        k4: f64,
        /// Of r⁴ in the denominator.
        k5: f64,
        /// Of r⁶ in the denominator.
        k6: f64,
    },
}

impl Distortion {
    /// Brown and Conrady's model from `k1 k2 p1 p2 k3`.
    pub const fn brown([k1, k2, p1, p2, k3]: [f64; 5]) -> Self {
        Self::Brown { k1, k2, p1, p2, k3 }
    }

    /// The rational model from `k1 k2 p1 p2 k3 k4 k5 k6`.
    pub const fn rational([k1, k2, p1, p2, k3, k4, k5, k6]: [f64; 8]) -> Self {
        Self::Rational { k1, k2, p1, p2, k3, k4, k5, k6 }
    }

    /// `k1 k2 p1 p2 k3 k4 k5 k6`, zero where the model lacks them.
    pub const fn coefficients(&self) -> [f64; 8] {
        match *self {
            Self::None => [0.0; 8],
            Self::Brown { k1, k2, p1, p2, k3 } => [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0],
            Self::Rational { k1, k2, p1, p2, k3, k4, k5, k6 } => [k1, k2, p1, p2, k3, k4, k5, k6],
        }
    }

    /// Whether the lens bends nothing.
    pub fn is_none(&self) -> bool {
        self.coefficients() == [0.0; 8]
    }

    /// Where the lens shows a normalised point `(X / Z, Y / Z)`.
    pub fn distort(&self, point: DVec2) -> DVec2 {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.coefficients();
        let DVec2 { x, y } = point;
        let r2 = point.length_squared();
        let factor = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let tangential =
            DVec2::new(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        point * factor + tangential
    }

    /// The derivative of [`Distortion::distort`].
    fn jacobian(&self, point: DVec2) -> DMat2 {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.coefficients();
        let DVec2 { x, y } = point;
        let r2 = point.length_squared();
        let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let factor = numerator / denominator;
        // Of the factor, by r².
        let slope =
            (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3) - factor * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) / denominator;
        // The matrix is symmetric: both the radial and the tangential part are gradients.
        let across = 2.0 * slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y;
        DMat2::from_cols(
            DVec2::new(factor + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x, across),
            DVec2::new(across, factor + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x),
        )
    }

    /// The normalised point that the lens shows at another one, by Newton's iteration from there; `None` where that finds
    /// none.
    pub fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
        let mut point = distorted;
        for _ in 0..32 {
            let error = self.distort(point) - distorted;
            if error.length_squared() <= 1e-26 * (1.0 + distorted.length_squared()) {
                return Some(point);
            }
            let jacobian = self.jacobian(point);
            // Beyond the fold lies another branch, which no ray takes.
            if jacobian.determinant() <= 0.0 {
                return None;
            }
            point -= jacobian.inverse() * error;
        }
        None
    }

    /// Where an image of a camera with this lens shows what a pinhole camera of the same intrinsics sees at a pixel.
    pub fn distort_pixel(&self, camera: &Intrinsics, pixel: DVec2) -> DVec2 {
        let point = camera.unproject(pixel, 1.0).truncate();
        self.distort(point) * DVec2::new(camera.fx, camera.fy) + DVec2::new(camera.cx, camera.cy)
    }

    /// A pixel of the pinhole image from which on the model cannot be meant: it gives no finite number, or the image folds
    /// over. Looks at a grid of pixels, the outermost corners among them.
    pub(crate) fn fold(&self, camera: &Intrinsics) -> Option<DVec2> {
        const STEPS: u32 = 64;
        if self.is_none() {
            return None;
        }
        let [_, _, _, _, _, k4, k5, k6] = self.coefficients();
        let size = DVec2::new(camera.width.into(), camera.height.into());
        let pixels = (0..=STEPS).flat_map(|j| (0..=STEPS).map(move |i| DVec2::new(i.into(), j.into())));
        let bad = |pixel: &DVec2| {
            let point = camera.unproject(*pixel, 1.0).truncate();
            let r2 = point.length_squared();
            let denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
            let determinant = self.jacobian(point).determinant();
            // A mirrored image, both of whose directions are turned, has a positive determinant too.
            let upright = self.jacobian(point).x_axis.x > 0.0;
            !(denominator > 0.0 && upright && determinant > 0.0 && self.distort(point).is_finite())
        };
        let pixels = pixels.map(|at| at / f64::from(STEPS) * size - 0.5);
        // The one nearest to the centre tells most.
        let from_centre = |p: &DVec2| camera.unproject(*p, 1.0).truncate().length_squared();
        pixels.filter(bad).min_by(|a, b| from_centre(a).total_cmp(&from_centre(b)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The colour camera of TUM RGB-D's first Kinect.
    const FR1: Distortion = Distortion::brown([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);

    #[test]
    fn distortion_follows_the_formula() {
        // By hand: r² = 0.25, f = 1 + 0.0656 - 0.05956875 + 0.0181765625 for (0.3, 0.4).
        let point = FR1.distort(DVec2::new(0.3, 0.4));
        let f = 1.024_207_812_5;
        let expected = DVec2::new(
            0.3 * f + 2.0 * -0.0054 * 0.12 + 0.0026 * (0.25 + 0.18),
            0.4 * f - 0.0054 * (0.25 + 0.32) + 2.0 * 0.0026 * 0.12,
        );
        assert!(point.abs_diff_eq(expected, 1e-12), "{point} but {expected}");
        let rational = Distortion::rational([0.2624, -0.9531, -0.0054, 0.0026, 1.1633, 1.0, 0.0, 0.0]);
        let radial = rational.distort(DVec2::new(0.3, 0.4)) - (expected - DVec2::new(0.3, 0.4) * f);
        assert!(radial.abs_diff_eq(DVec2::new(0.3, 0.4) * f / 1.25, 1e-12));
        assert_eq!(Distortion::None.distort(point), point);
        assert_eq!(Distortion::None.undistort(point), Some(point));
    }

    #[test]
    fn images_that_fold_over_are_found() {
        let camera = Intrinsics::new(640, 480, 517.3, 516.5, 318.6, 255.3);
        assert_eq!(FR1.fold(&camera), None);
        // r (1 - r²) turns back at r = 0.577, inside of the image.
        let folding = Distortion::brown([-1.0, 0.0, 0.0, 0.0, 0.0]);
        let fold = folding.fold(&camera).unwrap();
        let radius = camera.unproject(fold, 1.0).truncate().length();
        assert!((0.577..0.62).contains(&radius), "{radius}");
        // The same lens in front of a smaller image does no harm.
        assert_eq!(folding.fold(&Intrinsics::new(320, 240, 517.3, 516.5, 159.5, 119.5)), None);
        // A pole within the image, and numbers that are none.
        assert!(Distortion::rational([0.0, 0.0, 0.0, 0.0, 0.0, -4.0, 0.0, 0.0]).fold(&camera).is_some());
        assert!(Distortion::brown([f64::NAN, 0.0, 0.0, 0.0, 0.0]).fold(&camera).is_some());
        assert!(folding.undistort(DVec2::new(0.7, 0.0)).is_none(), "no ray gets there");
    }

    proptest! {
        #[test]
        fn undistortion_undoes_distortion_and_the_jacobian_is_its_derivative(
            k in prop::array::uniform8(-0.15..0.15f64), (x, y) in (-0.6..0.6f64, -0.5..0.5f64),
        ) {
            let [k1, k2, p1, p2, k3, k4, k5, k6] = k;
            let lens = Distortion::rational([k1, k2, 0.1 * p1, 0.1 * p2, k3, k4, k5, k6]);
            let point = DVec2::new(x, y);
            let back = lens.undistort(lens.distort(point)).expect("a mild lens");
            prop_assert!(back.abs_diff_eq(point, 1e-11), "{back} but {point}");
            let jacobian = lens.jacobian(point);
            let h = 1e-5;
            for axis in DVec2::AXES {
                let slope = (lens.distort(point + h * axis) - lens.distort(point - h * axis)) / (2.0 * h);
                prop_assert!(slope.abs_diff_eq(jacobian * axis, 1e-8));
            }
        }
    }
}
