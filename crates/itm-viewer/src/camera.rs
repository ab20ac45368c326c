//! The camera of the free view.

use glam::{DMat3, DQuat, DVec2, DVec3};
use itm_slam::{Intrinsics, Se3};

/// Vertical field of view.
const FIELD_OF_VIEW: f64 = 55.0 * std::f64::consts::PI / 180.0;
/// The camera never looks straight along the vertical, where left and right would change places.
const STEEPEST: f64 = 89.0 * std::f64::consts::PI / 180.0;

/// A camera that looks at a pivot: it turns around it, moves with it, and comes nearer to it.
///
/// Its vertical is the world's -y, which is up for a camera that was held level when the recording began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OrbitCamera {
    /// What it looks at (world frame, metres).
    pub(crate) pivot: DVec3,
    /// How far away it is, in metres.
    pub(crate) distance_m: f64,
    /// Turn about the vertical, to the right, in radians; at 0 it looks along the world's z.
    pub(crate) yaw: f64,
    /// How far it looks up, in radians.
    pub(crate) pitch: f64,
}

impl Default for OrbitCamera {
    fn default() -> Self {
        Self { pivot: DVec3::new(0.0, 0.0, 1.5), distance_m: 3.0, yaw: 0.4, pitch: -0.4 }
    }
}

impl OrbitCamera {
    /// A camera at a pose, as far as it can be: level, and with the pivot so far ahead.
    pub(crate) fn at(world_from_camera: &Se3, distance_m: f64) -> Self {
        let ahead = world_from_camera.rotation * DVec3::Z;
        let yaw = ahead.x.atan2(ahead.z);
        let pitch = (-ahead.y).clamp(-1.0, 1.0).asin().clamp(-STEEPEST, STEEPEST);
        Self { pivot: world_from_camera.translation + ahead * distance_m, distance_m, yaw, pitch }
    }

    fn rotation(&self) -> DQuat {
        // Columns are the camera's x, y and z in the world.
        let z = DVec3::new(self.yaw.sin() * self.pitch.cos(), -self.pitch.sin(), self.yaw.cos() * self.pitch.cos());
        let x = DVec3::new(self.yaw.cos(), 0.0, -self.yaw.sin());
        DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z))
    }

    /// Its pose.
    pub(crate) fn world_from_camera(&self) -> Se3 {
        let rotation = self.rotation();
        Se3::new(rotation, self.pivot - rotation * DVec3::Z * self.distance_m)
    }

    /// Its lens, for a picture of a size.
    pub(crate) fn intrinsics((width, height): (u32, u32)) -> Intrinsics {
        let focal = 0.5 * f64::from(height) / (0.5 * FIELD_OF_VIEW).tan();
        let middle = |pixels: u32| 0.5 * f64::from(pixels) - 0.5;
        Intrinsics::new(width, height, focal, focal, middle(width), middle(height))
    }

    /// Turns around the pivot, by radians: what is shown follows the pointer.
    pub(crate) fn orbit(&mut self, right: f64, down: f64) {
        self.yaw = (self.yaw + right) % std::f64::consts::TAU;
        self.pitch = (self.pitch - down).clamp(-STEEPEST, STEEPEST);
    }

    /// Turns on the spot, by radians.
    pub(crate) fn look_around(&mut self, right: f64, up: f64) {
        let centre = self.world_from_camera().translation;
        self.yaw = (self.yaw + right) % std::f64::consts::TAU;
        self.pitch = (self.pitch + up).clamp(-STEEPEST, STEEPEST);
        self.pivot = centre + self.rotation() * DVec3::Z * self.distance_m;
    }

    /// Moves camera and pivot, by shares of the picture's height: what is shown at the pivot follows the pointer.
    pub(crate) fn pan(&mut self, by: DVec2) {
        let height_m = 2.0 * self.distance_m * (0.5 * FIELD_OF_VIEW).tan();
        self.pivot -= self.rotation() * DVec3::new(by.x, by.y, 0.0) * height_m;
    }

    /// Comes nearer by a factor above 1, or goes away.
    pub(crate) fn dolly(&mut self, factor: f64) {
        self.distance_m = (self.distance_m / factor).clamp(0.05, 100.0);
    }

    /// Flies: moves camera and pivot along the camera's own axes, in metres.
    pub(crate) fn fly(&mut self, right_down_ahead_m: DVec3) {
        self.pivot += self.rotation() * right_down_ahead_m;
    }

    /// Takes another pivot without moving the camera: it turns to look at it.
    pub(crate) fn look_at(&mut self, pivot: DVec3) {
        let centre = self.world_from_camera().translation;
        let towards = pivot - centre;
        let distance_m = towards.length();
        if distance_m < 0.05 {
            return;
        }
        let ahead = towards / distance_m;
        self.yaw = ahead.x.atan2(ahead.z);
        self.pitch = (-ahead.y).clamp(-1.0, 1.0).asin().clamp(-STEEPEST, STEEPEST);
        self.distance_m = distance_m;
        self.pivot = centre + self.rotation() * DVec3::Z * distance_m;
    }

    /// Shows all of a box: its diagonal fits the picture.
    pub(crate) fn frame(&mut self, min: DVec3, max: DVec3) {
        self.pivot = 0.5 * (min + max);
        self.distance_m = (0.5 * (max - min).length() / (0.5 * FIELD_OF_VIEW).sin()).clamp(0.3, 100.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-9
    }

    #[test]
    fn the_pivot_is_straight_ahead_and_the_horizon_level() {
        let camera = OrbitCamera { yaw: 0.7, pitch: 0.3, ..OrbitCamera::default() };
        let pose = camera.world_from_camera();
        assert!(near(pose.transform_point(DVec3::Z * camera.distance_m), camera.pivot));
        // The camera's x is level, its y points down.
        assert!((pose.rotation * DVec3::X).y.abs() < 1e-12);
        assert!((pose.rotation * DVec3::Y).y > 0.9);
        // It looks up: ahead is against the world's y, which is down.
        assert!((pose.rotation * DVec3::Z).y < 0.0);
    }

    #[test]
    fn a_camera_at_a_level_pose_is_that_pose() {
        let camera = OrbitCamera { pivot: DVec3::new(1.0, 2.0, 3.0), distance_m: 2.0, yaw: -2.0, pitch: 0.5 };
        let again = OrbitCamera::at(&camera.world_from_camera(), 2.0);
        assert!(near(again.pivot, camera.pivot));
        assert!((again.yaw - camera.yaw).abs() < 1e-9 && (again.pitch - camera.pitch).abs() < 1e-9);
    }

    #[test]
    fn orbiting_keeps_the_pivot_and_looking_around_the_centre() {
        let mut camera = OrbitCamera::default();
        camera.orbit(0.3, -0.2);
        assert!(near(camera.pivot, OrbitCamera::default().pivot));
        let centre = camera.world_from_camera().translation;
        camera.look_around(0.4, 0.1);
        assert!(near(camera.world_from_camera().translation, centre));
        // What is between camera and pivot follows the pointer.
        let mut camera = OrbitCamera::default();
        let before_the_pivot = camera.world_from_camera().transform_point(DVec3::Z * 0.5 * camera.distance_m);
        camera.orbit(0.1, 0.1);
        let seen = camera.world_from_camera().inverse().transform_point(before_the_pivot);
        assert!(seen.x > 0.0 && seen.y > 0.0, "{seen}");
        camera.orbit(0.0, 10.0);
        assert!(camera.pitch < std::f64::consts::FRAC_PI_2);
    }

    #[test]
    fn panning_moves_what_is_at_the_pivot_with_the_pointer() {
        let mut camera = OrbitCamera::default();
        let (pivot, size) = (camera.pivot, (640, 480));
        camera.pan(DVec2::new(0.25, -0.1));
        let seen = camera.world_from_camera().inverse().transform_point(pivot);
        let lens = OrbitCamera::intrinsics(size);
        let pixel = lens.project(seen).expect("in front");
        let expected = DVec2::new(lens.cx + 0.25 * 480.0, lens.cy - 0.1 * 480.0);
        assert!((pixel - expected).length() < 1e-6, "{pixel} instead of {expected}");
    }

    #[test]
    fn another_pivot_moves_no_camera() {
        let mut camera = OrbitCamera::default();
        let centre = camera.world_from_camera().translation;
        camera.look_at(DVec3::new(2.0, 0.5, 4.0));
        assert!(near(camera.pivot, DVec3::new(2.0, 0.5, 4.0)));
        assert!(near(camera.world_from_camera().translation, centre));
        // Too near to say where to look.
        let before = camera;
        camera.look_at(centre);
        assert_eq!(camera, before);
    }

    #[test]
    fn a_box_fits_the_picture() {
        let mut camera = OrbitCamera::default();
        let (min, max) = (DVec3::new(-2.0, -1.0, 0.0), DVec3::new(3.0, 1.0, 4.0));
        camera.frame(min, max);
        let (lens, camera_from_world) = (OrbitCamera::intrinsics((640, 480)), camera.world_from_camera().inverse());
        for corner in 0..8 {
            let pick = |axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
            let seen = camera_from_world.transform_point(DVec3::new(pick(0), pick(1), pick(2)));
            let pixel = lens.project(seen).expect("in front");
            assert!((-0.5..639.5).contains(&pixel.x) && (-0.5..479.5).contains(&pixel.y), "{pixel}");
        }
    }
}
