//! From the sums of several error terms to one step of the pose.

use itm_gpu::icp::DepthTerm;
use itm_gpu::{DepthSums, PhotometricSums};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix6, Matrix6x2, SymmetricEigen, Vector2, Vector6};

use super::{Evaluation, Exposure, Guess, Part, Plan, Request};

/// Standard deviations of the terms' residuals, by which they are made comparable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Of distances from a plane, in metres.
    pub depth_m: f64,
    /// Of differences in colour (0 to 1), by [`super::Against`].
    pub colour: [f64; 2],
}

impl Default for Noise {
    fn default() -> Self {
        Self { depth_m: 0.005, colour: [0.04; 2] }
    }
}

impl Noise {
    /// As measured by the residuals of an evaluation; what it does not say stays as it was. Bounded, so that neither perfect
    /// nor useless data make a term count for everything or nothing.
    #[must_use]
    pub fn measured(self, evaluation: &Evaluation) -> Self {
        let rms = |squares: f64, count: u32| (squares / f64::from(count)).sqrt();
        let depth = evaluation.depth.filter(|d| d.count >= 100).map(|d| rms(d.squares, d.count).clamp(2e-4, 0.03));
        let colour = std::array::from_fn(|i| {
            let sums = evaluation.colour[i].filter(|c| c.count >= 100);
            sums.map_or(self.colour[i], |c| rms(c.squares, c.count).clamp(0.005, 0.1))
        });
        Self { depth_m: depth.unwrap_or(self.depth_m), colour }
    }
}

/// The normal equations of all terms together, in the six unknowns of the pose (see [`DepthSums`]).
#[derive(Clone, Debug, PartialEq)]
pub struct NormalEquations {
    /// JᵀWJ.
    pub hessian: Matrix6<f64>,
    /// JᵀWr.
    pub gradient: Vector6<f64>,
    /// Robust error of what was compared, for all that could have been: it does not fall by comparing less.
    pub cost: f64,
    /// The same, where what the model does not show counts as the largest error: by which starts are compared.
    pub cost_of_all: f64,
    /// Weight that a pair exactly on its plane would have, summed up: the scale of the Hessian.
    pub scale: f64,
    exposures: [Option<ExposureEquations>; 2],
}

/// What is left of a colour term's equations for its gain and offset once the pose's step is known.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ExposureEquations {
    inverse: Matrix2<f64>,
    cross: Matrix6x2<f64>,
    gradient: Vector2<f64>,
}

/// Standard deviation of an exposure's gain and offset from one estimate to the next, beyond which data must speak.
const EXPOSURE_PRIOR: [f64; 2] = [0.3, 0.1];

/// The robust error of a pair that is only just one.
fn largest_depth_error(term: &DepthTerm) -> f64 {
    let (limit, huber) = (f64::from(term.max_plane_distance_m.min(term.max_distance_m)), f64::from(term.huber_m));
    if limit <= huber { 0.5 * limit * limit } else { huber * (limit - 0.5 * huber) }
}

impl NormalEquations {
    /// The equations of an evaluation; each term is measured in its own standard deviations.
    pub fn new(evaluation: &Evaluation, request: &Request, plan: &Plan, noise: &Noise) -> Self {
        let mut equations = Self {
            hessian: Matrix6::zeros(),
            gradient: Vector6::zeros(),
            cost: 0.0,
            cost_of_all: 0.0,
            scale: 0.0,
            exposures: [None; 2],
        };
        if let Some(depth) = &evaluation.depth {
            equations.add_depth(depth, noise.depth_m, request.depth.as_ref().map_or(0.0, largest_depth_error));
        }
        for (index, colour) in evaluation.colour.iter().enumerate() {
            let Some(colour) = colour else { continue };
            let weight = plan.colour_weight / noise.colour[index].powi(2);
            let largest = request.colour[index].map_or(0.0, |term| f64::from(term.cutoff).powi(2) / 6.0);
            equations.add_colour(index, colour, weight, (noise.colour[index], largest), plan.estimate_exposure);
            if evaluation.depth.is_none() {
                equations.scale += weight * colour.weights;
            }
        }
        equations
    }

    fn add_depth(&mut self, sums: &DepthSums, sigma_m: f64, largest_error: f64) {
        let weight = sigma_m.powi(-2);
        self.hessian += weight * Matrix6::from_fn(|r, c| sums.hessian[r][c]);
        self.gradient += weight * Vector6::from(sums.gradient);
        let error = sums.cost + sums.apart * largest_error;
        self.add_cost(weight, error, sums.weights + sums.apart, sums.unseen, largest_error);
        self.scale += weight * sums.weights;
    }

    fn add_cost(&mut self, weight: f64, error: f64, compared: f64, unseen: f64, largest_error: f64) {
        self.cost +=
            weight * if compared > 0.0 { error / compared * (compared + unseen) } else { unseen * largest_error };
        self.cost_of_all += weight * (error + unseen * largest_error);
    }

    fn add_colour(
        &mut self,
        index: usize,
        sums: &PhotometricSums,
        weight: f64,
        (sigma, largest_error): (f64, f64),
        estimate_exposure: bool,
    ) {
        let block = weight * Matrix6::from_fn(|r, c| sums.hessian[r][c]);
        let gradient = weight * Vector6::from_fn(|r, _| sums.gradient[r]);
        self.add_cost(weight, sums.cost, sums.weights, sums.unseen, largest_error);
        self.hessian += block;
        self.gradient += gradient;
        if !estimate_exposure {
            return;
        }
        // Gain and offset are eliminated (Schur complement).
        let prior = Vector2::from(EXPOSURE_PRIOR).map(|s| weight * (sigma / s).powi(2));
        let own = weight * Matrix2::from_fn(|r, c| sums.hessian[6 + r][6 + c]) + Matrix2::from_diagonal(&prior);
        let cross = weight * Matrix6x2::from_fn(|r, c| sums.hessian[r][6 + c]);
        let of_exposure = weight * Vector2::new(sums.gradient[6], sums.gradient[7]);
        let Some(inverse) = own.try_inverse() else { return };
        self.hessian -= cross * inverse * cross.transpose();
        self.gradient -= cross * inverse * of_exposure;
        self.exposures[index] = Some(ExposureEquations { inverse, cross, gradient: of_exposure });
    }

    /// How well each direction of motion is determined, least first: eigenvalues of the Hessian for a pair's weight, with
    /// rotations in radians and translations in metres (compare Zhang, Kaess & Singh 2016, *On Degeneracy of
    /// Optimization-based State Estimation Problems*).
    pub fn information(&self) -> [f64; 6] {
        let mut values: [f64; 6] = (self.hessian / self.scale.max(1e-300)).symmetric_eigenvalues().into();
        values.sort_by(f64::total_cmp);
        values
    }

    /// The damped Gauss-Newton step in the unknowns that are estimated, zero in the others, and the number of directions that
    /// are held because they are less determined than `min_information` (Zhang, Kaess & Singh 2016: solution remapping);
    /// `None` where the equations determine no step.
    pub fn step(&self, part: Part, damping: f64, min_information: Option<f64>) -> Option<(Vector6<f64>, usize)> {
        let unknowns = part.unknowns();
        let n = unknowns.len();
        let hessian = DMatrix::from_fn(n, n, |r, c| self.hessian[(unknowns.start + r, unknowns.start + c)]);
        let gradient = DVector::from_fn(n, |r, _| self.gradient[unknowns.start + r]);
        let eigen = SymmetricEigen::try_new(hessian.clone(), 1e-14, 1000)?;
        let floor = min_information.unwrap_or(0.0).max(1e-9) * self.scale;
        let mut damped = hessian;
        for i in 0..n {
            damped[(i, i)] *= 1.0 + damping;
        }
        let free: Vec<usize> = (0..n).filter(|i| eigen.eigenvalues[*i] > floor).collect();
        if free.is_empty() {
            return None;
        }
        // In the coordinates of the directions that are free.
        let basis = DMatrix::from_fn(n, free.len(), |r, c| eigen.eigenvectors[(r, free[c])]);
        let reduced = basis.transpose() * damped * &basis;
        let step = -(&basis * reduced.cholesky()?.solve(&(basis.transpose() * gradient)));
        let mut full = Vector6::zeros();
        full.rows_mut(unknowns.start, n).copy_from(&step);
        full.iter().all(|v| v.is_finite()).then_some((full, n - free.len()))
    }

    /// The exposures that fit best once the pose has made a step.
    pub fn exposures(&self, guess: &Guess, step: &Vector6<f64>) -> [Exposure; 2] {
        std::array::from_fn(|i| {
            let old = guess.exposure[i];
            let Some(e) = &self.exposures[i] else { return old };
            let change = -(e.inverse * (e.gradient + e.cross.transpose() * step));
            // No camera's exposure changes further within a frame; what seems so is no match at all.
            Exposure { gain: (old.gain + change[0]).clamp(0.3, 3.0), offset: (old.offset + change[1]).clamp(-0.5, 0.5) }
        })
    }
}
