//! Robust kernels: what becomes of an edge's squared error in the sum.

/// How an edge's `χ²` counts in the cost.
///
/// A kernel is `ρ(χ²)`; the normal equations are weighted by its derivative (iteratively reweighted least squares).
/// Every kernel is `χ²` near zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Kernel {
    /// `ρ = χ²`: every edge is believed.
    #[default]
    None,
    /// Huber 1964: beyond `k` standard deviations the cost grows linearly. An outlier's pull stays constant.
    Huber(f64),
    /// Cauchy's: `k² ln(1 + χ²/k²)`. An outlier's pull falls off slowly.
    Cauchy(f64),
    /// Dynamic covariance scaling (Agarwal et al. 2013, *Robust Map Optimization Using Dynamic Covariance Scaling*): the
    /// closed form of switchable constraints (Sünderhauf and Protzel 2012). The edge's information is scaled by `s²`
    /// with `s = min(1, 2 φ / (φ + χ²))`, which is the derivative of `ρ = χ²` up to `φ`, and of
    /// `φ (3 χ² - φ) / (χ² + φ)` beyond. That tends to `3 φ`: an edge that the others contradict stops pulling.
    DynamicScaling {
        /// The `χ²` from which an edge counts less. True edges have up to 6 on average; where `φ` is below that, true
        /// closures are given up as well. [`Edge::CLOSURE_PHI`](crate::Edge::CLOSURE_PHI) is a good one.
        phi: f64,
    },
}

impl Kernel {
    /// `ρ(χ²)`.
    pub fn cost(self, chi2: f64) -> f64 {
        match self {
            Self::None => chi2,
            Self::Huber(k) if chi2 <= k * k => chi2,
            Self::Huber(k) => 2.0 * k * chi2.sqrt() - k * k,
            Self::Cauchy(k) => k * k * (chi2 / (k * k)).ln_1p(),
            Self::DynamicScaling { phi } if chi2 <= phi => chi2,
            // φ (3 χ² - φ) / (χ² + φ), written so that nothing overflows.
            Self::DynamicScaling { phi } => phi * (3.0 - 4.0 * phi / (chi2 + phi)),
        }
    }

    /// `dρ/dχ²`, between 0 and 1: the factor on the edge's information.
    pub fn weight(self, chi2: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber(k) if chi2 <= k * k => 1.0,
            Self::Huber(k) => k / chi2.sqrt(),
            Self::Cauchy(k) => 1.0 / (1.0 + chi2 / (k * k)),
            Self::DynamicScaling { phi } => (2.0 * phi / (phi + chi2)).min(1.0).powi(2),
        }
    }

    /// The kernel's width, if it has one.
    pub(crate) fn parameter(self) -> Option<f64> {
        match self {
            Self::None => None,
            Self::Huber(k) | Self::Cauchy(k) => Some(k),
            Self::DynamicScaling { phi } => Some(phi),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kernel() -> impl Strategy<Value = Kernel> {
        (0..4, 0.1..20.0f64).prop_map(|(kind, k)| match kind {
            0 => Kernel::None,
            1 => Kernel::Huber(k),
            2 => Kernel::Cauchy(k),
            _ => Kernel::DynamicScaling { phi: k },
        })
    }

    proptest! {
        #[test]
        fn a_weight_is_the_slope_of_the_cost(kernel in kernel(), chi2 in 0.0..1e4f64) {
            let h = 1e-5 * (1.0 + chi2);
            // Kernels change their form at one place, where the slope is continuous.
            let slope = (kernel.cost(chi2 + h) - kernel.cost(chi2)) / h;
            let (near, far) = (kernel.weight(chi2), kernel.weight(chi2 + h));
            prop_assert!(slope <= near + 1e-6 && slope >= far - 1e-6, "{slope} is not between {far} and {near}");
        }

        #[test]
        fn a_cost_neither_falls_nor_exceeds_least_squares(kernel in kernel(), a in 0.0..1e4f64, b in 0.0..1e4f64) {
            prop_assert!(kernel.cost(a.min(b)) <= kernel.cost(a.max(b)));
            prop_assert!(kernel.cost(a) <= a * (1.0 + 1e-12));
        }
    }

    #[test]
    fn what_is_scaled_away_costs_a_bounded_amount() {
        let kernel = Kernel::DynamicScaling { phi: 2.0 };
        assert_eq!((kernel.cost(2.0), kernel.weight(2.0)), (2.0, 1.0));
        assert!((kernel.cost(f64::MAX) - 6.0).abs() < 1e-12 && kernel.weight(f64::MAX) < 1e-100);
    }
}
