//! Reference of stage `icp`: the sums of point-to-plane ICP with projective association (Newcombe et al. 2011, section
//! 3.5; the report, section 3.1.1; Chen & Medioni 1992, *Object Modelling by Registration of Multiple Range Images*).

use glam::{DVec2, DVec3};
use itm_core::{Image, Intrinsics, Se3};

use crate::icp::NormalEquations;

/// The surface that a frame is aligned with: what a raycast from a pose has found.
#[derive(Clone, Debug)]
pub struct Model {
    /// World frame, metres.
    pub points: Image<Option<DVec3>>,
    /// World frame, unit length.
    pub normals: Image<Option<DVec3>>,
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
    /// Distance of the measured point from the plane, once a small motion about the pivot (see [`NormalEquations`]) has
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

/// The pair of a measured point that appears at a pixel of the model: the nearest pixel's, where that has a normal and
/// lies at most so far from the point.
pub fn pair(model: &Model, measured: DVec3, pixel: DVec2, max_distance_m: f64) -> Option<Pair> {
    let nearest = (pixel + 0.5).floor();
    if nearest.min_element() < 0.0 {
        return None;
    }
    let at = (nearest.x as u32, nearest.y as u32);
    let point = (*model.points.get(at.0, at.1)?)?;
    let normal = (*model.normals.get(at.0, at.1)?)?;
    (measured.distance(point) <= max_distance_m).then_some(Pair { measured, model: point, normal })
}

/// The normal equations of a depth image (metres, 0 where there is none), taken to be at `world_from_camera`, against a
/// model; the pivot is the model camera's centre.
pub fn icp(
    model: &Model,
    depth: &Image<f32>,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    max_distance_m: f32,
) -> NormalEquations {
    let pivot = model.world_from_camera.translation;
    let mut sums = NormalEquations { hessian: [[0.0; 6]; 6], gradient: [0.0; 6], squares: 0.0, count: 0, valid: 0 };
    for y in 0..depth.height() {
        for x in 0..depth.width() {
            sums.valid += u32::from(depth[(x, y)] > 0.0);
            let projected = project_into_model(model, depth, camera, world_from_camera, x, y);
            let pair = projected.and_then(|(world, pixel)| pair(model, world, pixel, max_distance_m.into()));
            let Some(pair) = pair else { continue };
            let residual = pair.residual([0.0; 6], pivot);
            let jacobian = pair.jacobian(pivot);
            for (row, a) in jacobian.iter().enumerate() {
                for (column, b) in jacobian.iter().enumerate() {
                    sums.hessian[row][column] += a * b;
                }
                sums.gradient[row] += a * residual;
            }
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
}
