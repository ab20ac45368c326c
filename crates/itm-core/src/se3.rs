//! Rigid motions.

use std::ops::Mul;

use glam::{DMat3, DMat4, DQuat, DVec3, Mat4};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A rigid motion in SE(3), as a unit quaternion and a translation in metres.
///
/// Name a value for what it does: `world_from_camera.transform_point(p_camera)` is a point in the world, and
/// `a_from_b * b_from_c` is `a_from_c`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Se3 {
    /// Rotation; kept at unit length by every constructor.
    pub rotation: DQuat,
    /// Translation in metres.
    pub translation: DVec3,
}

/// Why numbers are no rigid motion.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PoseError {
    /// At least one number is infinite or not a number.
    #[error("a pose must have finite numbers")]
    NotFinite,
    /// The upper left 3x3 block is far from a rotation.
    #[error(
        "the 3x3 part of a pose must be a rotation: its determinant is {determinant:.4} and its rows are {deviation:.4} away from orthonormal"
    )]
    NotARotation {
        /// Determinant of the 3x3 part; 1 for a rotation.
        determinant: f64,
        /// Largest absolute entry of `R Rᵀ - I`.
        deviation: f64,
    },
    /// The quaternion is too far from unit length to have been meant as a rotation.
    #[error("a pose's quaternion must have unit length, not {length:.4}")]
    NotAUnitQuaternion {
        /// Its length.
        length: f64,
    },
}

impl Default for Se3 {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Se3 {
    /// The motion that moves nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// A motion from a rotation, which is normalised, and a translation in metres.
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        Self { rotation: rotation.normalize(), translation }
    }

    /// Reads a quaternion and translation that came from outside.
    ///
    /// # Errors
    /// Where a number is not finite or the quaternion's length is more than 1 % away from one.
    pub fn try_from_quaternion(rotation: DQuat, translation: DVec3) -> Result<Self, PoseError> {
        if !(rotation.is_finite() && translation.is_finite()) {
            return Err(PoseError::NotFinite);
        }
        let length = rotation.length();
        if (length - 1.0).abs() > 0.01 {
            return Err(PoseError::NotAUnitQuaternion { length });
        }
        Ok(Self::new(rotation, translation))
    }

    /// Reads a 4x4 matrix (or the 3x4 part of one, with `0 0 0 1` as the last row) that came from outside.
    ///
    /// # Errors
    /// Where a number is not finite, or the 3x3 part is more than 2 % away from a rotation. Small deviations, as of
    /// matrices printed with four digits, are projected to the nearest rotation.
    pub fn try_from_matrix(matrix: DMat4) -> Result<Self, PoseError> {
        if !matrix.is_finite() {
            return Err(PoseError::NotFinite);
        }
        let r = DMat3::from_mat4(matrix);
        let determinant = r.determinant();
        let residual = r * r.transpose() - DMat3::IDENTITY;
        let deviation = residual.to_cols_array().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        if (determinant - 1.0).abs() > 0.02 || deviation > 0.02 {
            return Err(PoseError::NotARotation { determinant, deviation });
        }
        Ok(Self::new(DQuat::from_mat3(&r), matrix.w_axis.truncate()))
    }

    /// The exponential map from a twist `(v, ω)`: translational part first, in metres, then rotation vector in radians.
    ///
    /// # Panics
    /// Never; a twist that is not finite gives a motion that is not finite (see [`Se3::is_finite`]).
    pub fn exp(twist: [f64; 6]) -> Self {
        let v = DVec3::new(twist[0], twist[1], twist[2]);
        let w = DVec3::new(twist[3], twist[4], twist[5]);
        let theta2 = w.length_squared();
        let theta = theta2.sqrt();
        // Coefficients of the left Jacobian I + a [w] + b [w]^2; series below 1e-4 rad, where the closed forms cancel.
        let (a, b) = if theta < 1e-4 {
            (0.5 - theta2 / 24.0, 1.0 / 6.0 - theta2 / 120.0)
        } else {
            ((1.0 - theta.cos()) / theta2, (theta - theta.sin()) / (theta2 * theta))
        };
        let wv = w.cross(v);
        // Not glam's from_scaled_axis: it rounds rotations below about 1e-8 rad to the identity.
        let half_sinc = if theta < 1e-4 { 0.5 - theta2 / 48.0 } else { (0.5 * theta).sin() / theta };
        let rotation = DQuat::from_vec4((half_sinc * w).extend((0.5 * theta).cos())).normalize();
        Self { rotation, translation: v + a * wv + b * w.cross(wv) }
    }

    /// The logarithm: the twist `(v, ω)` with `Se3::exp(twist) == self` and a rotation angle of at most π.
    pub fn log(&self) -> [f64; 6] {
        let q = if self.rotation.w < 0.0 { -self.rotation } else { self.rotation };
        let sin_half = q.xyz().length();
        let scale = if sin_half < 1e-5 { 2.0 / q.w } else { 2.0 * sin_half.atan2(q.w) / sin_half };
        let w = scale * q.xyz();
        let theta2 = w.length_squared();
        let theta = theta2.sqrt();
        // Inverse of the left Jacobian: I - [w]/2 + c [w]^2.
        let c = if theta < 1e-4 {
            1.0 / 12.0 + theta2 / 720.0
        } else {
            (1.0 - 0.5 * theta * (0.5 * theta).cos() / (0.5 * theta).sin()) / theta2
        };
        let t = self.translation;
        let wt = w.cross(t);
        let v = t - 0.5 * wt + c * w.cross(wt);
        [v.x, v.y, v.z, w.x, w.y, w.z]
    }

    /// The motion that undoes this one.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Takes a point from the right-hand frame to the left-hand one.
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// Takes a direction from the right-hand frame to the left-hand one.
    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    /// As a homogeneous matrix.
    pub fn to_matrix(&self) -> DMat4 {
        DMat4::from_rotation_translation(self.rotation, self.translation)
    }

    /// As a homogeneous matrix in single precision, for shaders.
    pub fn to_mat4(&self) -> Mat4 {
        self.to_matrix().as_mat4()
    }

    /// Rotation angle in radians, between 0 and π.
    pub fn angle(&self) -> f64 {
        2.0 * self.rotation.xyz().length().atan2(self.rotation.w.abs())
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }
}

impl Mul for Se3 {
    type Output = Self;

    /// `a_from_b * b_from_c` is `a_from_c`.
    fn mul(self, rhs: Self) -> Self {
        Self::new(self.rotation * rhs.rotation, self.rotation * rhs.translation + self.translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn twist() -> impl Strategy<Value = [f64; 6]> {
        (prop::array::uniform3(-5.0..5.0f64), prop::array::uniform3(-1.7..1.7f64))
            .prop_map(|(v, w)| [v[0], v[1], v[2], w[0], w[1], w[2]])
    }

    proptest! {
        #[test]
        fn log_undoes_exp(t in twist()) {
            let back = Se3::exp(t).log();
            for i in 0..6 {
                prop_assert!((back[i] - t[i]).abs() < 1e-8, "{back:?} is not {t:?}");
            }
        }

        #[test]
        fn exp_matches_the_series_of_the_matrix_exponential(t in twist()) {
            let mut x = DMat4::from_cols_array(&[
                0.0, t[5], -t[4], 0.0, -t[5], 0.0, t[3], 0.0, t[4], -t[3], 0.0, 0.0, t[0], t[1], t[2], 0.0,
            ]);
            x *= 1.0 / 1024.0;
            let (mut sum, mut term) = (DMat4::IDENTITY, DMat4::IDENTITY);
            for n in 1..12 {
                term = term * x * (1.0 / f64::from(n));
                sum += term;
            }
            for _ in 0..10 {
                sum = sum * sum;
            }
            prop_assert!(Se3::exp(t).to_matrix().abs_diff_eq(sum, 1e-8));
        }

        #[test]
        fn a_motion_times_its_inverse_is_the_identity(t in twist()) {
            let p = Se3::exp(t);
            prop_assert!((p * p.inverse()).to_matrix().abs_diff_eq(DMat4::IDENTITY, 1e-12));
        }
    }

    #[test]
    fn small_twists_keep_their_digits() {
        let t = [1e-9, -2e-9, 3e-9, 4e-10, -5e-10, 6e-10];
        let back = Se3::exp(t).log();
        for i in 0..6 {
            assert!((back[i] - t[i]).abs() < 1e-15);
        }
    }

    #[test]
    fn matrices_that_are_no_rotation_are_refused() {
        assert_eq!(Se3::try_from_matrix(DMat4::NAN), Err(PoseError::NotFinite));
        let scaled = DMat4::from_scale(DVec3::splat(1.1));
        assert!(matches!(Se3::try_from_matrix(scaled), Err(PoseError::NotARotation { .. })));
        let mirrored = DMat4::from_scale(DVec3::new(1.0, -1.0, 1.0));
        assert!(matches!(Se3::try_from_matrix(mirrored), Err(PoseError::NotARotation { .. })));
        assert!(Se3::try_from_quaternion(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.5), DVec3::ZERO).is_err());
    }
}
