//! From the sums of several error terms to one step of the pose.

use glam::DMat3;
use itm_core::Se3;
use itm_gpu::icp::DepthTerm;
use itm_gpu::{DepthSums, PhotometricSums};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix6, Matrix6x2, SymmetricEigen, Vector2, Vector6};
use serde::{Deserialize, Serialize};

use super::{Evaluation, Exposure, Guess, Part, Plan, Request};

/// Standard deviations of the terms' residuals, by which they are made comparable.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Of distances from a plane, in metres, for a pixel that counts fully.
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
        // Of a pixel that counts fully: others have a weight for being noisier.
        let full = |d: DepthSums| (2.0 * d.cost / d.weights).sqrt();
        let depth = evaluation.depth.filter(|d| d.count >= 100 && d.weights > 0.0).map(|d| full(d).clamp(1e-4, 0.03));
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
    /// `colour_weight` is how much colour counts beside depth.
    pub fn new(evaluation: &Evaluation, request: &Request, plan: &Plan, noise: &Noise, colour_weight: f64) -> Self {
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
            let weight = colour_weight / noise.colour[index].powi(2);
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

    /// How much colour counts beside depth at an evaluation: less, the better depth alone determines every direction. Colour
    /// errs by more than its noise, where cameras are not quite in step or light depends on the view, and should decide only
    /// what depth leaves open.
    pub fn colour_weight(evaluation: &Evaluation, request: &Request, plan: &Plan, noise: &Noise) -> f64 {
        let Some(enough) = plan.enough_information.filter(|_| evaluation.depth.is_some()) else {
            return plan.colour_weight;
        };
        let of_depth = Evaluation { colour: [None; 2], ..*evaluation };
        let information = Self::new(&of_depth, request, plan, noise, 0.0).information()[0].max(0.0);
        plan.colour_weight / (1.0 + (information / enough).powi(2)).powi(4)
    }

    /// Covariance of the error of a pose that these equations are of, as a twist in the camera's own axes: metres, then radians.
    /// Directions that nothing determines are uncertain by a metre or a radian.
    pub fn covariance(&self, pose: &Se3) -> Matrix6<f64> {
        // The equations turn about a pivot near the camera, in the world's axes.
        let covariance = (self.hessian + Matrix6::identity()).try_inverse().unwrap_or_else(Matrix6::identity);
        let world_from_camera = DMat3::from_quat(pose.rotation);
        let mut turn = Matrix6::zeros();
        for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
            let value = world_from_camera.col(row)[column];
            turn[(row, column)] = value;
            turn[(row + 3, column + 3)] = value;
        }
        turn * covariance * turn.transpose()
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

#[cfg(test)]
mod tests {
    use itm_core::Settings;
    use nalgebra::{SMatrix, SVector};

    use super::*;
    use crate::tracking::Against;

    /// Sums of the depth term over points on planes, about the origin.
    fn planes(normals: &[[f64; 3]], weight: f64) -> DepthSums {
        let mut sums = DepthSums::default();
        for normal in normals.iter().map(|n| glam::DVec3::from_array(*n)) {
            let (along, across) = normal.any_orthonormal_pair();
            for i in 0..100 {
                let (a, b) = (f64::from(i % 10) / 4.5 - 1.0, f64::from(i / 10) / 4.5 - 1.0);
                let turn = (normal + a * along + b * across).cross(normal);
                let j = [normal.x, normal.y, normal.z, turn.x, turn.y, turn.z];
                for r in 0..6 {
                    for c in 0..6 {
                        sums.hessian[r][c] += weight * j[r] * j[c];
                    }
                }
                sums.weights += weight;
                sums.count += 1;
            }
        }
        sums
    }

    fn plan() -> (Plan, Request) {
        let settings = Settings::default();
        let plan = Plan::icp(&settings, &settings.tracker.icp, "b");
        let request = plan.levels[0].request;
        (plan, request)
    }

    #[test]
    fn a_plane_determines_three_directions_and_a_corner_all() {
        let (plan, request) = plan();
        let equations = |sums: DepthSums, noise: Noise| {
            let evaluation = Evaluation { depth: Some(sums), ..Evaluation::default() };
            NormalEquations::new(&evaluation, &request, &plan, &noise, plan.colour_weight)
        };
        let noise = Noise::default();
        let plane = equations(planes(&[[0.0, 0.0, 1.0]], 1.0), noise).information();
        assert!(plane[..3].iter().all(|v| v.abs() < 1e-12), "{plane:?}");
        // Motion along the normal moves each point by as much; turns about the middle of the 2 m wide plane move points by
        // 0.64 m at the root of the mean square.
        assert!(plane[3..5].iter().all(|v| (v - 0.407).abs() < 1e-3) && (plane[5] - 1.0).abs() < 1e-12, "{plane:?}");

        let three = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let corner = equations(planes(&three, 1.0), noise).information();
        assert!(corner.windows(2).all(|pair| pair[0] <= pair[1]));
        // Each direction by one plane, or two, of three.
        assert!(corner[0] > 0.2 && corner[5] < 1.0, "{corner:?}");
        // Neither the number of pairs, their weights nor their noise is what it measures.
        let other = equations(planes(&[three, three].concat(), 0.2), Noise { depth_m: 0.02, ..noise }).information();
        assert!(corner.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-12), "{corner:?} {other:?}");

        let step =
            |min_information| equations(planes(&[[0.0, 0.0, 1.0]], 1.0), noise).step(Part::Both, 0.0, min_information);
        assert_eq!(step(Some(0.1)).unwrap().1, 3);
        assert_eq!(step(Some(0.5)).unwrap().1, 5);
        assert_eq!(step(Some(2.0)), None, "nothing is left to move");
    }

    /// Sums of a colour term that is linear in its eight unknowns.
    fn linear(seed: f64) -> PhotometricSums {
        let mut sums = PhotometricSums { weights: 300.0, count: 300, valid: 300, ..PhotometricSums::default() };
        for i in 0..300 {
            let wave = |a: f64| (a * (f64::from(i) + seed)).sin();
            let j = [1.1, 2.3, 3.7, 4.1, 5.3, 6.7].map(wave);
            let (value, residual) = (0.5 + 0.4 * wave(7.9), 0.1 * wave(8.3) + 0.05 * wave(1.1) - 0.03);
            let j = [j[0], j[1], j[2], j[3], j[4], j[5], value, 1.0];
            for r in 0..8 {
                for c in 0..8 {
                    sums.hessian[r][c] += j[r] * j[c];
                }
                sums.gradient[r] += j[r] * residual;
            }
            sums.cost += 0.5 * residual * residual;
        }
        sums
    }

    #[test]
    fn eliminating_exposures_leaves_the_step_that_all_unknowns_together_take() {
        let settings = Settings::default();
        let rgb = Plan::rgb(&settings, &settings.tracker.rgb);
        let plan = Plan { estimate_exposure: true, colour_weight: 0.7, ..rgb };
        let mut request = plan.levels[0].request;
        request.colour = [request.colour[Against::Map as usize]; 2];
        let noise = Noise { colour: [0.02, 0.05], ..Noise::default() };
        let sums = [linear(0.0), linear(0.37)];
        let evaluation = Evaluation { colour: sums.map(Some), ..Evaluation::default() };
        let equations = NormalEquations::new(&evaluation, &request, &plan, &noise, plan.colour_weight);
        let (step, held) = equations.step(Part::Both, 0.0, None).unwrap();
        assert_eq!(held, 0);

        // The pose, then each term's gain and offset; that these change by less than their prior's deviations counts as one
        // further measurement each, as much as colour counts.
        let mut hessian = SMatrix::<f64, 10, 10>::zeros();
        let mut gradient = SVector::<f64, 10>::zeros();
        for (term, (sums, sigma)) in sums.iter().zip(noise.colour).enumerate() {
            let place = |i: usize| if i < 6 { i } else { i + 2 * term };
            for r in 0..8 {
                for c in 0..8 {
                    hessian[(place(r), place(c))] += 0.7 / (sigma * sigma) * sums.hessian[r][c];
                }
                gradient[place(r)] += 0.7 / (sigma * sigma) * sums.gradient[r];
            }
            for (i, deviation) in EXPOSURE_PRIOR.into_iter().enumerate() {
                hessian[(place(6 + i), place(6 + i))] += 0.7 / (deviation * deviation);
            }
        }
        let whole = -hessian.cholesky().unwrap().solve(&gradient);
        assert!((step - whole.fixed_rows::<6>(0)).norm() < 1e-12, "{step} but {whole}");
        let guess = Guess {
            exposure: [Exposure { gain: 1.1, offset: 0.02 }, Exposure { gain: 0.9, offset: -0.01 }],
            ..Guess::default()
        };
        for (term, (new, old)) in equations.exposures(&guess, &step).into_iter().zip(guess.exposure).enumerate() {
            let change = [new.gain - old.gain, new.offset - old.offset];
            let expected = [whole[6 + 2 * term], whole[7 + 2 * term]];
            assert!(expected[1].abs() > 1e-3, "there is something to estimate");
            assert!(change.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{change:?} but {expected:?}");
        }

        let without = Plan { estimate_exposure: false, ..plan };
        let equations = NormalEquations::new(&evaluation, &request, &without, &noise, without.colour_weight);
        assert_eq!(equations.exposures(&guess, &step), guess.exposure);
        let pose_only = hessian.fixed_view::<6, 6>(0, 0).cholesky().unwrap().solve(&gradient.fixed_rows::<6>(0));
        let (step, _) = equations.step(Part::Both, 0.0, None).unwrap();
        assert!((step + pose_only).norm() < 1e-12);
    }

    #[test]
    fn exposures_stay_within_what_a_camera_does() {
        let settings = Settings::default();
        let plan = Plan { estimate_exposure: true, ..Plan::rgb(&settings, &settings.tracker.rgb) };
        let mut sums = linear(0.0);
        (sums.gradient[6], sums.gradient[7]) = (-1e6, 1e6);
        let evaluation = Evaluation { colour: [None, Some(sums)], ..Evaluation::default() };
        let equations =
            NormalEquations::new(&evaluation, &plan.levels[0].request, &plan, &Noise::default(), plan.colour_weight);
        let [previous, map] = equations.exposures(&Guess::default(), &Vector6::zeros());
        assert_eq!(previous, Exposure::default());
        assert_eq!(map, Exposure { gain: 3.0, offset: -0.5 });
    }

    #[test]
    fn noise_is_what_residuals_show_within_bounds() {
        let depth = |rms: f64, count: u32| {
            let squares = rms * rms * f64::from(count);
            // Every other pixel counts fully, the rest, which are noisier, hardly.
            let weights = 0.5 * f64::from(count);
            Some(DepthSums {
                cost: 0.5 * rms * rms * weights,
                weights,
                squares: 9.0 * squares,
                count,
                ..DepthSums::default()
            })
        };
        let colour = |rms: f64, count: u32| {
            Some(PhotometricSums { squares: rms * rms * f64::from(count), count, ..PhotometricSums::default() })
        };
        let before = Noise { depth_m: 0.007, colour: [0.03, 0.06] };
        let measured = |depth, first, second| before.measured(&Evaluation { depth, colour: [first, second] });
        let close = |a: Noise, b: Noise| {
            (a.depth_m - b.depth_m).abs() < 1e-12 && a.colour.iter().zip(b.colour).all(|(a, b)| (a - b).abs() < 1e-12)
        };
        let all = measured(depth(0.004, 1000), colour(0.02, 500), colour(0.05, 100));
        assert!(close(all, Noise { depth_m: 0.004, colour: [0.02, 0.05] }), "{all:?}");
        // Perfect data, and useless ones.
        let perfect = measured(depth(0.0, 1000), colour(0.0, 500), colour(1e-4, 500));
        assert!(close(perfect, Noise { depth_m: 1e-4, colour: [0.005; 2] }), "{perfect:?}");
        let useless = measured(depth(1.0, 1000), colour(0.5, 500), colour(0.2, 500));
        assert!(close(useless, Noise { depth_m: 0.03, colour: [0.1; 2] }), "{useless:?}");
        // What is not there, or hardly, says nothing.
        assert_eq!(measured(None, None, None), before);
        assert_eq!(measured(depth(0.001, 99), colour(0.01, 0), colour(0.01, 99)), before);
    }
}
