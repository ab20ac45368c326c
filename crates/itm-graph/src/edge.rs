//! What was measured between two nodes.

use itm_core::{PoseError, Se3};
use nalgebra::{Matrix6, Vector6};

use crate::tangent::{adjoint, log, right_jacobian_inverse};
use crate::{Error, Kernel, NodeId};

/// How an edge came about. It changes nothing in the optimisation; a report can tell closures by it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum EdgeKind {
    /// From a node to the one that followed it.
    #[default]
    Sequential,
    /// From a node to one that was met again.
    Loop,
}

/// A measurement of where node `to` lies, seen from node `from`.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// The node measured from.
    pub from: NodeId,
    /// The node measured.
    pub to: NodeId,
    /// The measurement: `world_from_from⁻¹ * world_from_to`, were it exact.
    pub from_from_to: Se3,
    /// Inverse covariance of the measurement's error, a twist `(v, ω)` in the frame of `to`: translation (m) first,
    /// then rotation vector (rad). Symmetric and positive semidefinite.
    pub information: Matrix6<f64>,
    /// What becomes of a large error.
    pub kernel: Kernel,
    /// How the edge came about.
    pub kind: EdgeKind,
}

/// The information of a measurement whose error has the same standard deviation in each direction: `translation_m`
/// metres and `rotation_rad` radians about each axis. Both above zero; [`PoseGraph::add_edge`](crate::PoseGraph::add_edge)
/// refuses what comes of others.
pub fn information(translation_m: f64, rotation_rad: f64) -> Matrix6<f64> {
    let (t, r) = (translation_m.powi(-2), rotation_rad.powi(-2));
    Matrix6::from_diagonal(&Vector6::new(t, t, t, r, r, r))
}

impl Edge {
    /// The `χ²` up to which [`Edge::closure`] believes a closure wholly: what 99 % of true ones stay below, if their
    /// information is right (chi-squared, 6 degrees of freedom).
    pub const CLOSURE_PHI: f64 = 16.8;

    /// A measurement from a node to its successor, believed.
    pub fn sequential(from: NodeId, to: NodeId, from_from_to: Se3, information: Matrix6<f64>) -> Self {
        Self { from, to, from_from_to, information, kernel: Kernel::None, kind: EdgeKind::Sequential }
    }

    /// A loop closure, which may be false: with [`Kernel::DynamicScaling`] at [`Edge::CLOSURE_PHI`].
    pub fn closure(from: NodeId, to: NodeId, from_from_to: Se3, information: Matrix6<f64>) -> Self {
        let kernel = Kernel::DynamicScaling { phi: Self::CLOSURE_PHI };
        Self { from, to, from_from_to, information, kernel, kind: EdgeKind::Loop }
    }

    /// The edge with its numbers checked and made exact: rotation of unit length, information symmetric to the bit.
    pub(crate) fn checked(mut self) -> Result<Self, Error> {
        let Self { from, to, .. } = self;
        if from == to {
            return Err(Error::SelfEdge { id: from });
        }
        self.from_from_to = unit_pose(self.from_from_to).map_err(|reason| Error::Measurement { from, to, reason })?;
        self.information = symmetric(&self.information, from, to)?;
        match self.kernel.parameter() {
            Some(value) if !(1e-50..=1e50).contains(&value) => Err(Error::KernelParameter { from, to, value }),
            _ => Ok(self),
        }
    }

    /// The residual and `χ²` of the edge between nodes at these poses.
    pub(crate) fn error(&self, world_from_from: &Se3, world_from_to: &Se3) -> (Vector6<f64>, f64) {
        self.error_of(&(world_from_from.inverse() * *world_from_to))
    }

    /// The residual and `χ²` of the edge where `to` lies there, seen from `from`.
    fn error_of(&self, from_from_to: &Se3) -> (Vector6<f64>, f64) {
        let residual = log(&(self.from_from_to.inverse() * *from_from_to));
        // Rounding may leave the χ² of a semidefinite information below zero, where kernels are not defined.
        (residual, residual.dot(&(self.information * residual)).max(0.0))
    }

    /// The edge's part of the normal equations, for steps `world_from_node * exp(δ)`.
    pub(crate) fn linearise(&self, world_from_from: &Se3, world_from_to: &Se3) -> Linearised {
        let from_from_to = world_from_from.inverse() * *world_from_to;
        let (residual, chi2) = self.error_of(&from_from_to);
        // E exp(δ_to) moves the residual by J δ_to. A step of `from` is one of `to`, carried over and reversed.
        let jacobian = right_jacobian_inverse(&residual);
        let carried = adjoint(&from_from_to.inverse());
        let weighted = self.kernel.weight(chi2) * (jacobian.transpose() * self.information);
        let to_to = weighted * jacobian;
        let to_gradient = weighted * residual;
        let from_to = -carried.tr_mul(&to_to);
        Linearised {
            from_from: -from_to * carried,
            from_to,
            to_to,
            from_gradient: -carried.tr_mul(&to_gradient),
            to_gradient,
        }
    }
}

/// Blocks of `JᵀΩJ` and `JᵀΩe`, weighted by the kernel.
pub(crate) struct Linearised {
    pub(crate) from_from: Matrix6<f64>,
    pub(crate) from_to: Matrix6<f64>,
    pub(crate) to_to: Matrix6<f64>,
    pub(crate) from_gradient: Vector6<f64>,
    pub(crate) to_gradient: Vector6<f64>,
}

/// Checks a pose that came from outside. One that is of unit length already, to rounding, keeps its bits.
pub(crate) fn unit_pose(pose: Se3) -> Result<Se3, PoseError> {
    if pose.is_finite() && (pose.rotation.length_squared() - 1.0).abs() < 4.0 * f64::EPSILON {
        return Ok(pose);
    }
    Se3::try_from_quaternion(pose.rotation, pose.translation)
}

/// Checks an information matrix; small differences between the halves, as of printed digits, are averaged.
fn symmetric(given: &Matrix6<f64>, from: NodeId, to: NodeId) -> Result<Matrix6<f64>, Error> {
    const TOLERANCE: f64 = 1e-6;
    for (i, &value) in given.iter().enumerate() {
        if !(-1e100..=1e100).contains(&value) {
            return Err(Error::InformationNotFinite { from, to, row: i % 6, column: i / 6, value });
        }
    }
    let largest = given.amax();
    for (row, column) in (0..6).flat_map(|row| (0..row).map(move |column| (row, column))) {
        let difference = (given[(row, column)] - given[(column, row)]).abs();
        if difference > TOLERANCE * largest {
            return Err(Error::InformationNotSymmetric { from, to, row, column, difference });
        }
    }
    let matrix = 0.5 * (given + given.transpose());
    // Nearly all matrices have a Cholesky factor, which is much cheaper to find than eigenvalues.
    if matrix.cholesky().is_none() {
        let eigenvalue = matrix.symmetric_eigenvalues().min();
        if eigenvalue < -TOLERANCE * largest {
            return Err(Error::InformationNotPositive { from, to, eigenvalue });
        }
    }
    Ok(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tangent::tests::{differences, twist};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn blocks_are_those_of_differences(a in twist(), b in twist(), error in twist(), l in prop::array::uniform32(-1.0..1.0f64)) {
            let root = Matrix6::from_fn(|r, c| if r >= c { l[(6 * r + c) % 32] } else { 0.0 });
            let (a, b) = (Se3::exp(a), Se3::exp(b));
            let measured = a.inverse() * b * Se3::exp(error.map(|x| 0.3 * x));
            let edge = Edge {
                kernel: Kernel::Cauchy(2.0),
                ..Edge::closure(NodeId(0), NodeId(1), measured, root * root.transpose())
            };
            let (residual, chi2) = edge.error(&a, &b);
            let from = differences(|delta| edge.error(&(a * *delta), &b).0);
            let to = differences(|delta| edge.error(&a, &(b * *delta)).0);
            let weighted = edge.kernel.weight(chi2) * edge.information;
            let found = edge.linearise(&a, &b);
            for (found, numeric) in [
                (found.from_from, from.transpose() * weighted * from),
                (found.from_to, from.transpose() * weighted * to),
                (found.to_to, to.transpose() * weighted * to),
            ] {
                prop_assert!((found - numeric).amax() < 1e-6 * (1.0 + numeric.amax()), "{found}{numeric}");
            }
            for (found, numeric) in [
                (found.from_gradient, from.transpose() * weighted * residual),
                (found.to_gradient, to.transpose() * weighted * residual),
            ] {
                prop_assert!((found - numeric).amax() < 1e-6 * (1.0 + numeric.amax()), "{found}{numeric}");
            }
        }
    }
}
