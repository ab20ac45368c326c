//! A recording that is made as it is read.

use glam::Vec3;
use itm_core::{
    Calibration, DepthConversion, DepthImage, Frame, Image, Intrinsics, Se3, StampedPose, Timestamp, Trajectory,
};

use crate::{DepthNoise, Error, InertialNoise, InertialReading, Path, Quality, Rendering, Scene, inertial, render};

/// Time stamp of the first frame and the first inertial reading.
const START: Timestamp = Timestamp(1_000_000_000);

/// What to record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spec {
    /// The camera, of depth and colour alike: their images are registered.
    pub camera: Intrinsics,
    /// How it moves.
    pub path: Path,
    /// Seconds that the whole path takes: this, not the number of frames, sets the speed.
    pub duration_s: f64,
    /// Number of frames, from the start of the path; it goes on periodically after its end.
    pub frames: u32,
    /// Frames a second.
    pub frame_rate_hz: f64,
    /// Errors of depth; `None` for exact depth.
    pub noise: Option<DepthNoise>,
    /// Inertial readings a second.
    pub inertial_rate_hz: f64,
    /// Errors of the inertial sensors; `None` for exact readings.
    pub inertial_noise: Option<InertialNoise>,
    /// Work that goes into colours.
    pub quality: Quality,
    /// Chooses the noise. The same specification gives the same recording, byte for byte.
    pub seed: u64,
}

impl Spec {
    /// One pass of a path at its default speed: 30 frames and 200 inertial readings a second, 640x480 pixels with a
    /// Kinect's focal length, no noise, draft colours.
    pub fn new(path: Path) -> Self {
        let duration_s = path.default_duration_s();
        Self {
            camera: Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5),
            path,
            duration_s,
            frames: (duration_s * 30.0).round() as u32,
            frame_rate_hz: 30.0,
            noise: None,
            inertial_rate_hz: 200.0,
            inertial_noise: None,
            quality: Quality::Draft,
            seed: 0,
        }
    }

    /// The same with images of another size that show about the same.
    pub fn with_size(mut self, width: u32, height: u32) -> Self {
        self.camera = self.camera.scaled_to(width, height);
        self
    }

    /// The same with another number of frames, at the same speed.
    pub fn with_frames(mut self, frames: u32) -> Self {
        self.frames = frames;
        self
    }

    /// The same with a sensor's noise on depth, chosen by a seed.
    pub fn with_noise(mut self, noise: DepthNoise, seed: u64) -> Self {
        self.noise = Some(noise);
        self.seed = seed;
        self
    }

    fn validate(&self) -> Result<(), Error> {
        Calibration::registered(self.camera, DepthConversion::TUM).validate()?;
        for (name, value, most) in [
            ("the duration in seconds", self.duration_s, 1e6),
            ("the frame rate in Hz", self.frame_rate_hz, 1e5),
            ("the rate of inertial readings in Hz", self.inertial_rate_hz, 1e5),
        ] {
            if !(1e-3..=most).contains(&value) {
                return Err(Error::Value { name, expected: "positive and finite", found: value });
            }
        }
        Ok(())
    }
}

/// A recording that is made as it is read: each frame when it is asked for, in any order, from any thread.
///
/// ```
/// use itm_synth::{Path, Sequence, Spec};
///
/// let sequence = Sequence::new(Spec::new(Path::Arc).with_size(64, 48).with_frames(3))?;
/// for frame in sequence.frames() {
///     assert_eq!(frame.depth.size(), (64, 48));
///     assert!(frame.world_from_camera.is_some());
/// }
/// # Ok::<(), itm_synth::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Sequence {
    spec: Spec,
    scene: Scene,
}

impl Sequence {
    /// A recording of [`Scene::room`].
    ///
    /// # Errors
    /// Where a number of the specification cannot be meant.
    pub fn new(spec: Spec) -> Result<Self, Error> {
        Self::of_scene(Scene::room(), spec)
    }

    /// A recording of another scene, through which the path must lead.
    ///
    /// # Errors
    /// Where a number of the specification cannot be meant.
    pub fn of_scene(scene: Scene, spec: Spec) -> Result<Self, Error> {
        spec.validate()?;
        Ok(Self { spec, scene })
    }

    /// What is recorded.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The camera, and how depth is encoded where it is written to files.
    pub fn calibration(&self) -> Calibration {
        Calibration::registered(self.spec.camera, DepthConversion::TUM)
    }

    /// Time stamp of a frame: from 1 s on, to the nearest nanosecond.
    pub fn timestamp(&self, index: u32) -> Timestamp {
        Timestamp(START.0 + (f64::from(index) * 1e9 / self.spec.frame_rate_hz).round() as i64)
    }

    /// Exact pose of a frame.
    pub fn world_from_camera(&self, index: u32) -> Se3 {
        self.spec.path.world_from_camera(self.seconds(index), self.spec.duration_s)
    }

    /// Exact poses of all frames.
    pub fn trajectory(&self) -> Trajectory {
        (0..self.spec.frames)
            .map(|i| StampedPose { timestamp: self.timestamp(i), world_from_camera: self.world_from_camera(i) })
            .collect()
    }

    /// A frame: depth in metres, with noise if that was asked for, colour, and the exact pose. Where the lens is
    /// covered, depth is 0 and colour black everywhere.
    pub fn frame(&self, index: u32) -> Frame {
        let Spec { camera, .. } = self.spec;
        let world_from_camera = self.world_from_camera(index);
        let (depth, colour) = if self.spec.path.covered(self.seconds(index), self.spec.duration_s) {
            (
                Image::filled(camera.width, camera.height, 0.0),
                Image::filled(camera.width, camera.height, [0, 0, 0, 255]),
            )
        } else {
            let Rendering { depth, normals, colour } =
                render(&self.scene, &camera, &world_from_camera, self.spec.quality);
            (self.sense(depth, &normals, index), colour)
        };
        Frame::new(u64::from(index), self.timestamp(index), DepthImage::Metres(depth), Some(colour))
            .at_pose(world_from_camera)
    }

    /// All frames in order.
    pub fn frames(&self) -> impl ExactSizeIterator<Item = Frame> + '_ {
        (0..self.spec.frames).map(|i| self.frame(i))
    }

    /// Inertial readings from the first frame to the last.
    pub fn inertial(&self) -> Vec<InertialReading> {
        let Spec { path, duration_s, frames, inertial_rate_hz, inertial_noise, seed, .. } = self.spec;
        let end_s = self.seconds(frames.max(1) - 1);
        let count = (end_s * inertial_rate_hz + 1e-6).floor() as u64 + 1;
        (0..count)
            .map(|i| {
                let time_s = i as f64 / inertial_rate_hz;
                let timestamp = Timestamp(START.0 + (time_s * 1e9).round() as i64);
                let exact = inertial::reading(path, time_s, duration_s, timestamp);
                inertial_noise.map_or(exact, |noise| noise.apply(exact, seed, i))
            })
            .collect()
    }

    fn sense(&self, depth: Image<f32>, normals: &Image<Vec3>, index: u32) -> Image<f32> {
        match &self.spec.noise {
            Some(noise) => noise.apply(&depth, normals, &self.spec.camera, self.spec.seed, u64::from(index)),
            None => depth,
        }
    }

    /// Seconds from the start of the path to a frame.
    fn seconds(&self, index: u32) -> f64 {
        f64::from(index) / self.spec.frame_rate_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inertial::GRAVITY_WORLD;
    use glam::DVec3;

    #[test]
    fn turning_rates_add_up_to_the_rotation() {
        for path in Path::ALL {
            let mut spec = Spec::new(path).with_size(8, 6);
            spec.inertial_rate_hz = 1000.0;
            let sequence = Sequence::new(spec).unwrap();
            let mut turned = sequence.world_from_camera(0);
            let readings = sequence.inertial();
            for pair in readings.windows(2) {
                let w = 0.5 * (pair[0].gyroscope + pair[1].gyroscope) * 1e-3;
                turned = turned * Se3::exp([0.0, 0.0, 0.0, w.x, w.y, w.z]);
            }
            let last = sequence.world_from_camera(spec.frames - 1);
            let left_over = readings.last().unwrap().timestamp.0 - sequence.timestamp(spec.frames - 1).0;
            assert!(left_over.abs() <= 1_000_000, "the readings last as long as the frames");
            // What the camera turns in the millisecond that may be missing at the end is the larger part.
            let error = (turned.inverse() * last).angle();
            assert!(error < 4e-3, "{path}: {error} rad");
        }
    }

    #[test]
    fn forces_add_up_to_the_translation() {
        let mut spec = Spec::new(Path::Arc).with_size(8, 6);
        spec.inertial_rate_hz = 1000.0;
        let sequence = Sequence::new(spec).unwrap();
        // The arc starts at rest.
        let mut position = sequence.world_from_camera(0).translation;
        let mut velocity = DVec3::ZERO;
        let mut time_s = 0.0;
        for reading in sequence.inertial() {
            let rotation = spec.path.world_from_camera(time_s, spec.duration_s).rotation;
            let acceleration = rotation * reading.accelerometer + GRAVITY_WORLD;
            position += velocity * 1e-3 + 0.5e-6 * acceleration;
            velocity += acceleration * 1e-3;
            time_s += 1e-3;
        }
        let expected = spec.path.world_from_camera(time_s, spec.duration_s).translation;
        assert!(position.distance(expected) < 1e-3, "{position} is not {expected}");
    }

    #[test]
    fn a_camera_at_rest_feels_gravity() {
        // So slow that it stands still.
        let mut spec = Spec::new(Path::Loop).with_size(8, 6).with_frames(30);
        spec.duration_s = 1e5;
        spec.inertial_noise = Some(InertialNoise::PHONE);
        let sequence = Sequence::new(spec).unwrap();
        let readings = sequence.inertial();
        assert_eq!(readings.len(), 194);
        let n = readings.len() as f64;
        let mean = readings.iter().map(|r| r.accelerometer).sum::<DVec3>() / n;
        let rotation = sequence.world_from_camera(0).rotation;
        let expected = rotation.conjugate() * -GRAVITY_WORLD + InertialNoise::PHONE.accelerometer_bias;
        assert!(mean.distance(expected) < 5.0 * 0.02 / n.sqrt(), "{mean} is not {expected}");
        let turning = readings.iter().map(|r| r.gyroscope).sum::<DVec3>() / n;
        assert!(turning.distance(InertialNoise::PHONE.gyroscope_bias) < 1e-3, "{turning}");
        let spread = readings.iter().map(|r| (r.accelerometer - mean).length_squared()).sum::<f64>() / (3.0 * n);
        assert!((spread.sqrt() / 0.02 - 1.0).abs() < 0.15, "{}", spread.sqrt());
    }

    #[test]
    fn a_covered_lens_sees_nothing_for_a_while() {
        let sequence = Sequence::new(Spec::new(Path::Covered).with_size(16, 12)).unwrap();
        let dark: Vec<bool> = sequence
            .frames()
            .map(|frame| {
                let DepthImage::Metres(depth) = &frame.depth else { panic!("metres") };
                let black = frame.colour.unwrap().data().iter().all(|c| c[..3] == [0; 3]);
                assert_eq!(black, depth.data().iter().all(|z| *z == 0.0));
                black
            })
            .collect();
        assert_eq!(dark.len(), 120);
        let expected: Vec<bool> = (0..120).map(|i| (48..84).contains(&i)).collect();
        assert_eq!(dark, expected);
    }

    #[test]
    fn frames_do_not_depend_on_threads_or_order() {
        let spec = Spec::new(Path::Loop).with_size(48, 36).with_frames(4).with_noise(DepthNoise::KINECT, 9);
        let frames = |threads: usize, order: [u32; 4]| {
            let sequence = Sequence::new(spec).unwrap();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut frames = pool.install(|| order.map(|i| sequence.frame(i)));
            frames.sort_by_key(|f| f.index);
            frames.map(|f| (f.timestamp, f.depth, f.colour, f.world_from_camera))
        };
        assert_eq!(frames(1, [0, 1, 2, 3]), frames(3, [2, 0, 3, 1]));
    }

    #[test]
    fn what_cannot_be_recorded_is_refused() {
        let good = Spec::new(Path::Arc);
        let bad = [
            Spec { duration_s: 0.0, ..good },
            Spec { frame_rate_hz: f64::NAN, ..good },
            Spec { inertial_rate_hz: -1.0, ..good },
        ];
        for spec in bad {
            assert!(matches!(Sequence::new(spec), Err(Error::Value { .. })));
        }
        assert!(matches!(Sequence::new(good.with_size(0, 480)), Err(Error::Camera(_))));
    }

    #[test]
    fn surfaces_are_where_a_depth_camera_sees_them() {
        for path in Path::ALL {
            let sequence = Sequence::new(Spec::new(path).with_size(40, 30)).unwrap();
            let (mut pixels, mut near) = (0usize, 0usize);
            for i in (0..sequence.spec().frames).step_by(10) {
                if path.covered(sequence.seconds(i), sequence.spec().duration_s) {
                    continue;
                }
                let frame = sequence.frame(i);
                let DepthImage::Metres(depth) = &frame.depth else { panic!("metres") };
                let good = depth.data().iter().filter(|z| (0.6..3.0).contains(*z)).count();
                assert!(good * 10 > depth.data().len() * 8, "{path}: {good} pixels of frame {i} between 0.6 and 3 m");
                pixels += depth.data().len();
                near += good;
            }
            assert!(near * 100 > pixels * 95, "{path}: {near} of {pixels}");
        }
    }
}
