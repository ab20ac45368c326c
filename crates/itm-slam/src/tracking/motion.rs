//! Where the camera may be before a frame is looked at: how it moved so far, and what an inertial sensor says.

use glam::{DQuat, DVec3};
use itm_core::{AngularRate, Frame, ImuSettings, Se3, Timestamp, ViewSettings};
use serde::{Deserialize, Serialize};

/// How the camera moved lately.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// The last pose and its time.
    last: Option<(Timestamp, Se3)>,
    /// Velocity as a twist a second in the camera's own axes, from the last two poses.
    velocity: Option<[f64; 6]>,
    /// Gyroscope readings since the last pose, in the sensor's axes.
    readings: Vec<AngularRate>,
    /// Orientation that the inertial sensor gave at the last pose.
    imu_orientation: Option<DQuat>,
}

/// Velocities are not carried over gaps longer than this.
const LONGEST_GAP_S: f64 = 0.5;

impl Motion {
    /// Takes in what a frame's inertial sensor says; once for each frame, before anything is predicted.
    pub fn sense(&mut self, frame: &Frame) {
        self.readings.extend_from_slice(&frame.gyroscope);
    }

    /// A frame's pose became known.
    pub fn moved_to(&mut self, frame: &Frame, world_from_camera: Se3) {
        let time = frame.timestamp;
        self.velocity = self.last.and_then(|(before, pose)| {
            let seconds = seconds_between(before, time);
            let usable = seconds > 1e-6 && seconds <= LONGEST_GAP_S;
            usable.then(|| (pose.inverse() * world_from_camera).log().map(|v| v / seconds))
        });
        self.last = Some((time, world_from_camera));
        // The last one is where integration starts.
        let keep = self.readings.iter().rposition(|r| r.timestamp <= time).unwrap_or(0);
        self.readings.drain(..keep);
        self.imu_orientation = frame.imu_orientation;
    }

    /// Goes back to an earlier pose, at rest: after a loss.
    pub fn return_to(&mut self, world_from_camera: Se3) {
        self.velocity = None;
        if let Some((_, pose)) = &mut self.last {
            *pose = world_from_camera;
        }
    }

    /// The camera is at rest at its last pose, and what an inertial sensor said before tells nothing of the next frame.
    pub fn interrupt(&mut self) {
        self.velocity = None;
        self.readings.clear();
        self.imu_orientation = None;
    }

    /// The same motion as poses in another frame have it.
    pub fn seen_from(&self, other_from_world: &Se3) -> Self {
        let last = self.last.map(|(time, pose)| (time, *other_from_world * pose));
        Self { last, ..self.clone() }
    }

    /// Forgets the last pose and the velocity: the camera is found somewhere else.
    pub fn forget(&mut self) {
        self.velocity = None;
        self.last = None;
    }

    /// How much further than from the last pose to a frame's depth image the camera goes until its colour image is taken, as
    /// a share of that way.
    pub fn colour_lead(&self, frame: &Frame, view: &ViewSettings) -> f64 {
        let taken = frame.colour_timestamp.filter(|_| view.colour_times).unwrap_or(frame.timestamp);
        let later_s = seconds_between(frame.timestamp, taken) + view.colour_delay_s;
        let way_s = self.last.map_or(0.0, |(before, _)| seconds_between(before, frame.timestamp));
        if way_s > 1e-6 && way_s <= LONGEST_GAP_S { (later_s / way_s).clamp(-1.0, 2.0) } else { 0.0 }
    }

    /// The last pose.
    pub fn last(&self) -> Option<Se3> {
        self.last.map(|(_, pose)| pose)
    }

    /// Velocity as a twist a second in the camera's own axes.
    pub fn velocity(&self) -> Option<[f64; 6]> {
        self.velocity
    }

    /// The pose at a time if the camera goes on as it did; `None` without a velocity.
    pub fn predicted(&self, time: Timestamp) -> Option<Se3> {
        let (before, pose) = self.last?;
        let seconds = seconds_between(before, time).clamp(0.0, LONGEST_GAP_S);
        Some(pose * Se3::exp(self.velocity?.map(|v| v * seconds)))
    }

    /// The last pose turned as the inertial sensor says, for a frame; `None` where it says nothing.
    pub fn turned(&self, frame: &Frame, imu: &ImuSettings) -> Option<Se3> {
        let (before, pose) = self.last?;
        let camera_from_imu = DQuat::from_array(imu.camera_from_imu).normalize();
        let turn = match (self.imu_orientation, frame.imu_orientation) {
            (Some(then), Some(now)) => then.inverse() * now,
            _ => integrate(&self.readings, before, frame.timestamp, DVec3::from_array(imu.gyroscope_bias))?,
        };
        Some(pose * Se3::new(camera_from_imu * turn * camera_from_imu.inverse(), DVec3::ZERO))
    }
}

fn seconds_between(a: Timestamp, b: Timestamp) -> f64 {
    b.0.saturating_sub(a.0) as f64 * 1e-9
}

/// The rotation from one time to another by readings at and between them, each holding half-way to its neighbours; before
/// the first and after the last one the nearest holds. `None` without readings.
fn integrate(readings: &[AngularRate], from: Timestamp, to: Timestamp, bias: DVec3) -> Option<DQuat> {
    let first = readings.first()?;
    let rate_at = |time: Timestamp| {
        let after = readings.partition_point(|r| r.timestamp <= time);
        let (Some(b), Some(a)) = (readings.get(after), after.checked_sub(1).map(|i| &readings[i])) else {
            return readings.get(after).or(readings.last()).unwrap_or(first).rad_per_s - bias;
        };
        let share = seconds_between(a.timestamp, time) / seconds_between(a.timestamp, b.timestamp);
        a.rad_per_s.lerp(b.rad_per_s, share) - bias
    };
    let inner = readings.iter().map(|r| r.timestamp).filter(|t| *t > from && *t < to);
    let times: Vec<Timestamp> = std::iter::once(from).chain(inner).chain([to]).collect();
    let mut turn = DQuat::IDENTITY;
    for pair in times.windows(2) {
        // The rate half-way, as it is linear in between.
        let rate = 0.5 * (rate_at(pair[0]) + rate_at(pair[1]));
        turn = (turn * DQuat::from_scaled_axis(rate * seconds_between(pair[0], pair[1]))).normalize();
    }
    Some(turn)
}

#[cfg(test)]
mod tests {
    use itm_core::{DepthImage, Image};

    use super::*;

    fn frame(ms: i64) -> Frame {
        Frame::new(0, Timestamp(ms * 1_000_000), DepthImage::Metres(Image::filled(1, 1, 1.0)), None)
    }

    #[test]
    fn the_camera_goes_on_as_it_did_also_over_a_gap() {
        let step = [0.01, 0.0, -0.02, 0.0, 0.05, 0.01];
        let mut motion = Motion::default();
        assert_eq!(motion.predicted(Timestamp(0)), None);
        motion.moved_to(&frame(0), Se3::IDENTITY);
        assert_eq!(motion.predicted(Timestamp(30_000_000)), None);
        motion.moved_to(&frame(30), Se3::exp(step));
        let after_gap = motion.predicted(frame(90).timestamp).unwrap();
        let expected = Se3::exp(step.map(|v| 3.0 * v));
        assert!((expected.inverse() * after_gap).log().iter().all(|v| v.abs() < 1e-12));
        // Nothing is known after a second.
        motion.moved_to(&frame(2000), Se3::exp(step));
        assert_eq!(motion.predicted(frame(2030).timestamp), None);
    }

    #[test]
    fn a_gyroscopes_turn_is_applied_in_the_cameras_axes() {
        let rate = DVec3::new(0.3, -0.2, 1.0);
        let bias = DVec3::new(0.01, 0.02, -0.01);
        // The sensor lies turned by 90 degrees about z in the camera.
        let camera_from_imu = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let imu = ImuSettings {
            camera_from_imu: camera_from_imu.to_array(),
            gyroscope_bias: bias.to_array(),
            ..ImuSettings::default()
        };
        let mut motion = Motion::default();
        motion.moved_to(&frame(0), Se3::exp([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]));
        let mut next = frame(33);
        assert_eq!(motion.turned(&next, &imu), None);
        for ms in [3, 11, 20, 29] {
            next.gyroscope.push(AngularRate { timestamp: Timestamp(ms * 1_000_000), rad_per_s: rate + bias });
        }
        motion.sense(&next);
        let turned = motion.turned(&next, &imu).unwrap();
        let w = camera_from_imu * rate * 0.033;
        let expected = motion.last().unwrap() * Se3::exp([0.0, 0.0, 0.0, w.x, w.y, w.z]);
        assert!((expected.inverse() * turned).log().iter().all(|v| v.abs() < 1e-9));
    }

    #[test]
    fn orientations_of_the_sensor_give_the_turn_between_them() {
        let imu = ImuSettings::default();
        let mut motion = Motion::default();
        let (mut first, mut second) = (frame(0), frame(33));
        first.imu_orientation = Some(DQuat::from_rotation_x(0.4));
        second.imu_orientation = Some(DQuat::from_rotation_x(0.4) * DQuat::from_rotation_y(0.1));
        motion.moved_to(&first, Se3::IDENTITY);
        let turned = motion.turned(&second, &imu).unwrap();
        assert!((turned.rotation.inverse() * DQuat::from_rotation_y(0.1)).to_scaled_axis().length() < 1e-12);
    }
}
