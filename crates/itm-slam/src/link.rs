//! Where one submap lies in another, measured by a camera that is tracked in both (Kähler et al. 2016, *Real-Time Large-Scale
//! Dense 3D Reconstruction with Loop Closure*, section 2.3).

use itm_core::{Se3, SubmapSettings};
use itm_graph::{Edge, NodeId, PoseGraph};
use nalgebra::{Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector6};
use serde::{Deserialize, Serialize};

use crate::atlas::check_pose;

/// Rounds of reweighting.
const ROUNDS: usize = 10;

/// One frame's measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Observation {
    pub(crate) from_from_to: Se3,
    /// Of its error as a twist in the axes of `to`.
    covariance: [[f64; 6]; 6],
}

impl Observation {
    /// Of a camera that is tracked in two submaps, the one with the lower number first. Covariances are those of the camera's
    /// pose there, as a twist in the camera's own axes.
    pub(crate) fn new(
        [from_from_camera, to_from_camera]: [&Se3; 2],
        [of_from, of_to]: [&Matrix6<f64>; 2],
        settings: &SubmapSettings,
    ) -> Self {
        let SubmapSettings { link_deviation_m: metres, link_deviation_rad: radians, .. } = settings;
        let [m, r] = [metres * metres, radians * radians];
        let least = Matrix6::from_diagonal(&Vector6::new(m, m, m, r, r, r));
        let adjoint = adjoint(to_from_camera);
        let covariance = adjoint * (of_from + of_to + least) * adjoint.transpose();
        Self { from_from_to: *from_from_camera * to_from_camera.inverse(), covariance: covariance.into() }
    }
}

/// What is known of where a submap lies in another one.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Link {
    pub(crate) from: u16,
    pub(crate) to: u16,
    /// Whether the camera came back to get it.
    pub(crate) closure: bool,
    observations: Vec<Observation>,
    /// The pose found, and the share of the frames that agree with it.
    found: Option<(Se3, f64)>,
    information: [[f64; 6]; 6],
}

impl Link {
    /// Between two submaps, the one with the lower number first.
    pub(crate) fn new([from, to]: [u16; 2], closure: bool) -> Self {
        let zero = [[0.0; 6]; 6];
        Self { from, to, closure, observations: Vec::new(), found: None, information: zero }
    }

    /// What it is found by among others.
    pub(crate) fn key(&self) -> (u16, u16, bool) {
        (self.from, self.to, self.closure)
    }

    /// Why no session with so many submaps can use it, where it was read back from a file.
    pub(crate) fn check(&self, submaps: usize) -> Result<(), String> {
        let Self { from, to, .. } = *self;
        if let Some(missing) = [from, to].into_iter().find(|end| usize::from(*end) >= submaps) {
            return Err(format!("there is no submap {missing}"));
        }
        if from == to {
            return Err("it joins a submap with itself".into());
        }
        if from > to {
            return Err("the submap with the higher number comes first".into());
        }
        for Observation { from_from_to, covariance } in &self.observations {
            check_pose(from_from_to).map_err(|reason| format!("a frame's measurement of it is none: {reason}"))?;
            let covariance = Matrix6::from(*covariance);
            let finite = covariance.iter().all(|value| value.is_finite());
            if !finite || covariance.symmetric_eigenvalues().min() < -1e-6 * covariance.amax() {
                return Err("the covariance of a frame's measurement of it is none".into());
            }
        }
        let Some((pose, share)) = self.found else { return Ok(()) };
        if !(0.0..=1.0).contains(&share) {
            return Err(format!("{share} is no share of frames"));
        }
        let mut graph = PoseGraph::new();
        let ends = [from, to].map(|end| NodeId(end.into()));
        let edge = Edge::sequential(ends[0], ends[1], pose, self.information.into());
        let added = ends.into_iter().try_for_each(|end| graph.add_node(end, Se3::IDENTITY));
        added.and_then(|()| graph.add_edge(edge)).map_err(|error| error.to_string())
    }

    /// Frames that measured it, of those that are kept.
    pub(crate) fn frames(&self) -> usize {
        self.observations.len()
    }

    /// Takes a frame's measurement in. Whether the link is measured by it for the first time.
    pub(crate) fn observe(&mut self, observation: Observation, settings: &SubmapSettings) -> bool {
        let most = settings.link_window as usize;
        if self.observations.len() >= most {
            self.observations.drain(..=self.observations.len() - most);
        }
        self.observations.push(observation);
        if self.observations.len() < settings.link_frames as usize {
            return false;
        }
        let before = self.found.is_some();
        self.estimate(settings);
        !before
    }

    /// The pose between the submaps and its information, where enough frames agree on it.
    pub(crate) fn measured(&self, settings: &SubmapSettings) -> Option<(Se3, Matrix6<f64>)> {
        let (pose, share) = self.found?;
        (share >= settings.link_inliers).then(|| (pose, self.information.into()))
    }

    /// The share of its frames that agree, once there are enough.
    pub(crate) fn agreement(&self) -> Option<f64> {
        self.found.map(|(_, share)| share)
    }

    /// The mean of the observations, weighted by what each frame's equations know of each direction and reweighted by Huber's
    /// kernel.
    fn estimate(&mut self, settings: &SubmapSettings) {
        let huber = settings.link_huber;
        let mut pose = self.observations[self.observations.len() / 2].from_from_to;
        let off = |pose: &Se3, o: &Observation| (pose.inverse() * o.from_from_to).log();
        let length = |twist: &[f64; 6]| twist.iter().map(|v| v * v).sum::<f64>().sqrt();
        let known: Vec<Matrix6<f64>> = self.observations.iter().map(|o| inverse(o.covariance.into())).collect();
        for _ in 0..ROUNDS {
            let (mut sum, mut weights) = (Vector6::zeros(), Matrix6::zeros());
            for (observation, known) in self.observations.iter().zip(&known) {
                let twist = off(&pose, observation);
                let weight = (huber / length(&twist).max(1e-300)).min(1.0);
                weights += known * weight;
                sum += known * Vector6::from(twist) * weight;
            }
            let Some(step) = weights.cholesky().map(|weights| <[f64; 6]>::from(weights.solve(&sum))) else { break };
            pose = pose * Se3::exp(step);
            if length(&step) < 1e-9 {
                break;
            }
        }
        let agree: Vec<&Observation> = self.observations.iter().filter(|o| length(&off(&pose, o)) <= huber).collect();
        let share = agree.len() as f64 / self.observations.len() as f64;
        self.found = Some((pose, share));
        // The frames see one surface with one sensor: their errors are much the same, so that many say no more than their mean.
        let mut covariance = Matrix6::zeros();
        for observation in &agree {
            covariance += Matrix6::from(observation.covariance) / agree.len() as f64;
        }
        self.information = inverse(covariance).into();
    }
}

/// Two measurements of one pose, each confirmed, as one: half-way between them, and no better known than they differ. They
/// differ because the submaps are bent, and neither is right for all of them.
pub(crate) fn together(a: (Se3, Matrix6<f64>), b: (Se3, Matrix6<f64>)) -> (Se3, Matrix6<f64>) {
    let half = (a.0.inverse() * b.0).log().map(|v| 0.5 * v);
    let apart = Vector6::from(half);
    let covariance = (inverse(a.1) + inverse(b.1)) * 0.5 + apart * apart.transpose();
    (a.0 * Se3::exp(half), inverse(covariance))
}

/// The information of a measurement with a covariance, or the other way round.
fn inverse(covariance: Matrix6<f64>) -> Matrix6<f64> {
    let information = covariance.try_inverse().unwrap_or_else(Matrix6::zeros);
    0.5 * (information + information.transpose())
}

/// What takes a twist in the axes of `b` to one in those of `a`, for `a_from_b`; translation first.
fn adjoint(a_from_b: &Se3) -> Matrix6<f64> {
    let [x, y, z, w] = a_from_b.rotation.to_array();
    let r = *UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix().matrix();
    let t = a_from_b.translation;
    let cross = Matrix3::new(0.0, -t.z, t.y, t.z, 0.0, -t.x, -t.y, t.x, 0.0);
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
    adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&(cross * r));
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
    adjoint
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(from_from_to: Se3) -> Observation {
        let camera = Se3::exp([0.2, 0.1, -0.3, 0.1, 0.4, 0.0]);
        let covariance = Matrix6::from_diagonal_element(1e-6);
        Observation::new([&(from_from_to * camera), &camera], [&covariance, &covariance], &SubmapSettings::default())
    }

    #[test]
    fn the_adjoint_carries_twists_over() {
        let a_from_b = Se3::exp([0.3, -0.7, 0.5, 0.4, -0.2, 0.9]);
        let twist = [0.02, -0.01, 0.03, 0.005, 0.02, -0.01];
        let there = a_from_b * Se3::exp(twist) * a_from_b.inverse();
        let carried: [f64; 6] = (adjoint(&a_from_b) * Vector6::from(twist)).into();
        assert!(there.log().iter().zip(carried).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn two_links_together_are_less_sure_where_they_differ() {
        let pose = Se3::exp([1.0, 0.2, -0.4, 0.1, 0.8, 0.0]);
        let known = Matrix6::from_diagonal_element(1e6);
        let (same, information) = together((pose, known), (pose, known));
        assert!((pose.inverse() * same).log().iter().all(|v| v.abs() < 1e-12));
        assert!((information - known).amax() < 1.0);
        let aside = pose * Se3::exp([0.02, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let (between, information) = together((pose, known), (aside, known));
        assert!(((pose.inverse() * between).translation.x - 0.01).abs() < 1e-9);
        // 1 cm along x, 1 mm otherwise.
        assert!((information[(0, 0)] - 1.0 / 1.01e-4).abs() < 1.0, "{information}");
        assert!((information[(1, 1)] - 1e6).abs() < 1.0);
    }

    #[test]
    fn a_few_wrong_frames_do_not_move_a_link_and_many_leave_it_unmeasured() {
        let settings = SubmapSettings { link_huber: 0.02, ..SubmapSettings::default() };
        let truth = Se3::exp([1.0, 0.2, -0.4, 0.1, 0.8, 0.0]);
        let mut link = Link::new([0, 1], false);
        for i in 0..20 {
            let wrong = if i % 10 == 3 { Se3::exp([0.8, 0.0, 0.0, 0.0, 0.3, 0.0]) } else { Se3::IDENTITY };
            let noise = Se3::exp([1e-4 * f64::from(i % 3 - 1), 0.0, 0.0, 0.0, 0.0, 0.0]);
            let first = link.observe(observation(truth * noise * wrong), &settings);
            assert_eq!(first, i == 9, "frame {i}");
        }
        let (pose, information) = link.measured(&settings).expect("18 of 20 agree");
        assert!((truth.inverse() * pose).log().iter().all(|v| v.abs() < 3e-3), "{pose:?}");
        assert!(information.symmetric_eigenvalues().min() > 0.0);
        for i in 0..10 {
            link.observe(observation(truth * Se3::exp([0.1 * f64::from(i + 1), 0.0, 0.0, 0.0, 0.0, 0.0])), &settings);
        }
        assert!(link.measured(&settings).is_none(), "{:?}", link.agreement());
    }
}
