//! Derivatives on SE(3), for twists `(v, ω)`: translation first, then rotation vector.
//!
//! After Solà et al. 2018 (*A Micro Lie Theory for State Estimation in Robotics*), sections IV and appendix D.

use glam::{DMat3, DVec3};
use itm_core::Se3;
use nalgebra::{Matrix3, Matrix6, Vector6};

fn skew(w: DVec3) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

/// `[a, b; 0, a]`.
fn upper(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix6<f64> {
    let mut m = Matrix6::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(a);
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(b);
    m.fixed_view_mut::<3, 3>(3, 3).copy_from(a);
    m
}

/// The logarithm as a column.
pub(crate) fn log(motion: &Se3) -> Vector6<f64> {
    Vector6::from(motion.log())
}

/// The adjoint: `a_from_b * exp(ξ) = exp(adjoint(a_from_b) ξ) * a_from_b`.
pub(crate) fn adjoint(a_from_b: &Se3) -> Matrix6<f64> {
    let r = DMat3::from_quat(a_from_b.rotation);
    let r = Matrix3::from_column_slice(&r.to_cols_array());
    upper(&r, &(skew(a_from_b.translation) * r))
}

/// Inverse of the right Jacobian: `log(exp(ξ) exp(δ)) = ξ + right_jacobian_inverse(ξ) δ` to first order in `δ`.
pub(crate) fn right_jacobian_inverse(twist: &Vector6<f64>) -> Matrix6<f64> {
    // The right Jacobian at ξ is the left one at -ξ.
    let v = skew(-DVec3::new(twist[0], twist[1], twist[2]));
    let omega = -DVec3::new(twist[3], twist[4], twist[5]);
    let w = skew(omega);
    let theta2 = omega.length_squared();
    let inverse = Matrix3::identity() - 0.5 * w + half_angle_term(theta2) * (w * w);
    let wv = w * v;
    let vw = v * w;
    let wvw = wv * w;
    let (c3, c4, c5) = (tail(3, theta2), -tail(4, theta2), -tail(5, theta2));
    let q = 0.5 * v + c3 * (wv + vw + wvw)
        - c4 * (w * wv + vw * w - 3.0 * wvw)
        - 0.5 * (c4 - 3.0 * c5) * (wvw * w + w * wvw);
    upper(&inverse, &-(inverse * q * inverse))
}

/// `(1 - θ/2 cot(θ/2)) / θ²`, of the inverse of SO(3)'s left Jacobian.
fn half_angle_term(theta2: f64) -> f64 {
    let half = 0.5 * theta2.sqrt();
    if half < 1e-3 {
        1.0 / 12.0 + theta2 / 720.0 + theta2 * theta2 / 30240.0
    } else {
        (1.0 - half * half.cos() / half.sin()) / theta2
    }
}

/// `Σ (-1)ᵏ θ²ᵏ / (2k + m)!`: what is left of sine or cosine without its first terms, divided by a power of `θ`. For
/// angles up to π the first term dominates, so that the sum loses no digits, which the closed forms do.
fn tail(m: u32, theta2: f64) -> f64 {
    let mut term = 1.0 / (1..=m).map(f64::from).product::<f64>();
    let mut sum = term;
    for k in 1..16 {
        let n = f64::from(2 * k + m);
        term *= -theta2 / (n * (n - 1.0));
        sum += term;
        if term.abs() < 0.1 * f64::EPSILON * sum {
            break;
        }
    }
    sum
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Twists of all sizes up to 5 m and nearly a half turn.
    pub(crate) fn twist() -> impl Strategy<Value = [f64; 6]> {
        (prop::array::uniform3(-5.0..5.0f64), prop::array::uniform3(-1.7..1.7f64), 0.0..9.0f64).prop_map(
            |(v, w, digits)| [v[0], v[1], v[2], w[0], w[1], w[2]].map(|x| x * 10f64.powf(-(digits - 3.0).max(0.0))),
        )
    }

    /// Central differences of `f` at zero.
    pub(crate) fn differences(f: impl Fn(&Se3) -> Vector6<f64>) -> Matrix6<f64> {
        let h = 1e-5;
        Matrix6::from_columns(&std::array::from_fn::<_, 6, _>(|i| {
            let step = |h| {
                let mut delta = [0.0; 6];
                delta[i] = h;
                f(&Se3::exp(delta))
            };
            (step(h) - step(-h)) / (2.0 * h)
        }))
    }

    proptest! {
        #[test]
        fn the_right_jacobian_is_that_of_differences(t in twist()) {
            let numeric = differences(|delta| log(&(Se3::exp(t) * *delta)));
            let analytic = right_jacobian_inverse(&Vector6::from(t));
            prop_assert!((numeric - analytic).amax() < 1e-8, "{numeric}{analytic}");
        }

        #[test]
        fn an_adjoint_carries_a_twist_across_a_motion(t in twist(), x in twist()) {
            let motion = Se3::exp(t);
            let moved = motion * Se3::exp(x) * motion.inverse();
            let carried: [f64; 6] = (adjoint(&motion) * Vector6::from(x)).into();
            prop_assert!(moved.to_matrix().abs_diff_eq(Se3::exp(carried).to_matrix(), 1e-10));
        }
    }
}
