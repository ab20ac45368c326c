//! Reference of stage `icp`: the sums of the depth term, point-to-plane with projective association (Newcombe et al. 2011,
//! section 3.5; the report, sections 3.1.1 and 3.1.3; Chen & Medioni 1992, *Object Modelling by Registration of Multiple Range Images*).

use glam::{DVec2, DVec3};
use itm_core::{DepthWeight, Image, Intrinsics, Se3};

use crate::DepthSums;
use crate::icp::DepthTerm;

/// The surface that a frame is aligned with: what a raycast from a pose has found.
#[derive(Clone, Debug)]
pub struct Model {
    /// World frame, metres.
    pub points: Image<Option<DVec3>>,
    /// World frame, unit length.
    pub normals: Image<Option<DVec3>>,
    /// How often each point was observed, at least once.
    pub observations: Image<u16>,
    /// Camera of both images.
    pub camera: Intrinsics,
    /// Its pose.
    pub world_from_camera: Se3,
}

/// A measured point and the plane that it should lie in (world frame, metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The measured point.
    pub measured: DVec3,
    /// A point of the plane.
    pub model: DVec3,
    /// The plane's normal.
    pub normal: DVec3,
}

impl Pair {
    /// Distance of the measured point from the plane, once a small motion about the pivot (see [`DepthSums`]) has
    /// moved it.
    pub fn residual(&self, twist: [f64; 6], pivot: DVec3) -> f64 {
        let moved = pivot + Se3::exp(twist).transform_point(self.measured - pivot);
        (moved - self.model).dot(self.normal)
    }

    /// Derivatives of the residual by the twist, at no motion.
    pub fn jacobian(&self, pivot: DVec3) -> [f64; 6] {
        // n · (v + ω × a) = n · v + ω · (a × n)
        let rotation = (self.measured - pivot).cross(self.normal);
        [self.normal.x, self.normal.y, self.normal.z, rotation.x, rotation.y, rotation.z]
    }
}

/// The point that a depth pixel measures (world frame), and where in the model's image it appears, in pixels; `None` where
/// nothing was measured, or behind the model's camera.
pub fn project_into_model(
    model: &Model,
    depth: &Image<f32>,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    x: u32,
    y: u32,
) -> Option<(DVec3, DVec2)> {
    let z = depth[(x, y)];
    if z <= 0.0 {
        return None;
    }
    let in_camera = camera.unproject(DVec2::new(x.into(), y.into()), z.into());
    let world = world_from_camera.transform_point(in_camera);
    let pixel = model.camera.project(model.world_from_camera.inverse().transform_point(world))?;
    Some((world, pixel))
}

/// What a measured point that appears at a pixel of the model has for a partner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Partner {
    /// The nearest pixel's point, with its confidence from 0 to 1.
    Pair(Pair, f64),
    /// The nearest pixel's point lies too far behind the measured one.
    InFront,
    /// The nearest pixel's point lies too far in front of the measured one.
    Behind,
    /// The model shows nothing there, or nothing that was observed often enough.
    Nothing,
}

/// The partner of a measured point (world frame) that appears at a pixel of the model.
pub fn partner(model: &Model, measured: DVec3, pixel: DVec2, term: &DepthTerm) -> Partner {
    let nearest = (pixel + 0.5).floor();
    if nearest.min_element() < 0.0 {
        return Partner::Nothing;
    }
    let at = (nearest.x as u32, nearest.y as u32);
    let point_and_normal = || Some(((*model.points.get(at.0, at.1)?)?, (*model.normals.get(at.0, at.1)?)?));
    let Some((point, normal)) = point_and_normal() else { return Partner::Nothing };
    let observations = f64::from(model.observations[at]);
    if observations < term.least_confidence.into() {
        return Partner::Nothing;
    }
    let pair = Pair { measured, model: point, normal };
    let plane_distance = pair.residual([0.0; 6], model.world_from_camera.translation).abs();
    if measured.distance(point) > term.max_distance_m.into() || plane_distance > term.max_plane_distance_m.into() {
        let to_camera = model.world_from_camera.translation - measured;
        return if (measured - point).dot(to_camera) >= 0.0 { Partner::InFront } else { Partner::Behind };
    }
    let full = f64::from(term.full_confidence);
    Partner::Pair(pair, if full > 0.0 { (observations / full).min(1.0) } else { 1.0 })
}

/// A pixel's weight by its depth `z` in metres.
pub fn weight_by_depth(weight: DepthWeight, [near, far]: [f32; 2], z: f64) -> f64 {
    match weight {
        DepthWeight::None => 1.0,
        DepthWeight::Linear => (1.0 - (z - f64::from(near)) / f64::from(far - near)).clamp(0.0, 1.0).powi(2),
        DepthWeight::Noise => (0.0012 / (0.0012 + 0.0019 * (z - 0.4).max(0.0).powi(2))).powi(2),
    }
}

/// Huber's error of a residual, and the weight by which it counts in the normal equations (Huber 1964).
pub fn huber(residual: f64, limit: f64) -> (f64, f64) {
    let size = residual.abs();
    if size <= limit { (0.5 * size * size, 1.0) } else { (limit * (size - 0.5 * limit), limit / size) }
}

/// The sums over a depth image (metres, 0 where there is none), taken to be at `world_from_camera`, against a model; the
/// pivot is the model camera's centre.
pub fn icp(
    model: &Model,
    depth: &Image<f32>,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    term: &DepthTerm,
) -> DepthSums {
    let pivot = model.world_from_camera.translation;
    let mut sums = DepthSums::default();
    for y in (0..depth.height()).step_by(term.stride as usize) {
        for x in (0..depth.width()).step_by(term.stride as usize) {
            if depth[(x, y)] <= 0.0 {
                continue;
            }
            let weight = weight_by_depth(term.weight, term.depth_range_m, depth[(x, y)].into());
            if weight <= 0.0 {
                continue;
            }
            sums.valid += 1;
            let projected = project_into_model(model, depth, camera, world_from_camera, x, y);
            let partner = projected.map_or(Partner::Nothing, |(world, pixel)| partner(model, world, pixel, term));
            let (pair, confidence) = match partner {
                Partner::Pair(pair, confidence) => (pair, confidence),
                Partner::InFront => {
                    (sums.in_front, sums.apart) = (sums.in_front + 1, sums.apart + weight);
                    continue;
                }
                Partner::Behind => {
                    (sums.behind, sums.apart) = (sums.behind + 1, sums.apart + weight);
                    continue;
                }
                Partner::Nothing => {
                    sums.unseen += weight;
                    continue;
                }
            };
            let residual = pair.residual([0.0; 6], pivot);
            let jacobian = pair.jacobian(pivot);
            let (error, robust) = huber(residual, term.huber_m.into());
            let w = weight * confidence;
            for (row, a) in jacobian.iter().enumerate() {
                for (column, b) in jacobian.iter().enumerate() {
                    sums.hessian[row][column] += w * robust * a * b;
                }
                sums.gradient[row] += w * robust * a * residual;
            }
            sums.cost += w * error;
            sums.weights += w;
            sums.squares += residual * residual;
            sums.count += 1;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        [-2.0..2.0, -2.0..2.0, -2.0..2.0].prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn the_jacobian_is_the_residuals_derivative(
            measured in vector(), model in vector(), normal in vector(), pivot in vector(),
        ) {
            prop_assume!(normal.length() > 0.1);
            let pair = Pair { measured, model, normal: normal.normalize() };
            for (i, derivative) in pair.jacobian(pivot).into_iter().enumerate() {
                let step = |h: f64| {
                    let mut twist = [0.0; 6];
                    twist[i] = h;
                    pair.residual(twist, pivot)
                };
                // Central differences: an error of h² / 6 times the third derivative, which is at most |arm| < 7.
                let numeric = (step(1e-4) - step(-1e-4)) / 2e-4;
                prop_assert!((numeric - derivative).abs() < 1e-7, "{i}: {numeric} but {derivative}");
            }
        }
    }

    #[test]
    fn the_weight_of_depth_follows_its_formulas() {
        let weight = |kind, z| weight_by_depth(kind, [0.5, 2.5], z);
        assert_eq!(weight(DepthWeight::None, 9.0), 1.0);
        assert_eq!([0.5, 1.5, 2.5, 9.0].map(|z| weight(DepthWeight::Linear, z)), [1.0, 0.25, 0.0, 0.0]);
        assert_eq!(weight(DepthWeight::Noise, 0.3), 1.0);
        // At 3 m the noise is 0.0012 + 0.0019 * 6.76 = 14.0 mm.
        assert!((weight(DepthWeight::Noise, 3.0) - (1.2_f64 / 14.044).powi(2)).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn hubers_weight_is_its_errors_slope(residual in -1.0..1.0f64, limit in 0.01..0.5f64) {
            prop_assume!((residual.abs() - limit).abs() > 1e-5);
            let slope = (huber(residual + 1e-6, limit).0 - huber(residual - 1e-6, limit).0) / 2e-6;
            let (error, weight) = huber(residual, limit);
            prop_assert!((weight * residual - slope).abs() < 1e-6);
            prop_assert!(error <= 0.5 * residual * residual + 1e-15);
        }
    }
}
