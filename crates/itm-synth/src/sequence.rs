//! A recording that is made as it is read.

use std::borrow::Cow;
use std::ops::Range;

use glam::Vec3;
use itm_core::{
    AngularRate, Calibration, ColourImage, DepthConversion, DepthImage, Frame, Image, Intrinsics, Se3, StampedPose,
    Timestamp, Trajectory,
};

use crate::cover::{cover_colour, cover_depth};
use crate::render::render_colour;
use crate::texture::{colour, to_srgb};
use crate::{
    Brightness, Cover, DepthNoise, Error, Exposure, InertialNoise, InertialReading, Path, Quality, Rendering, Scene,
    SceneName, inertial, render, render_depth,
};

/// Time stamp of the first frame and the first inertial reading.
const START: Timestamp = Timestamp(1_000_000_000);

/// What to record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spec {
    /// The camera, of depth and colour alike: their images are registered.
    pub camera: Intrinsics,
    /// How it moves.
    pub path: Path,
    /// Where: one of [`Path::scenes`].
    pub scene: SceneName,
    /// Seconds that the whole path takes: this, not the number of frames, sets the speed.
    pub duration_s: f64,
    /// Number of frames, from the start of the path; it goes on periodically after its end.
    pub frames: u32,
    /// Whether the camera turns back half-way through the frames and goes the way back that it came: see
    /// [`Spec::there_and_back`].
    pub turns_back: bool,
    /// Frames a second.
    pub frame_rate_hz: f64,
    /// Errors of depth; `None` for exact depth.
    pub noise: Option<DepthNoise>,
    /// A hand over the lens; `None` for none but the path's own ([`Path::cover`]).
    pub cover: Option<Cover>,
    /// Whether frames have colour: without, they take a fraction of the time.
    pub colour: bool,
    /// Changes of colours' brightness; `None` for the same in all frames.
    pub exposure: Option<Exposure>,
    /// Colour is taken so many seconds later than depth (earlier, where negative): from where the camera is then.
    pub colour_delay_s: f64,
    /// Seconds that the colour camera's shutter is open, half of them before the moment of the image and half after it:
    /// colour is the mean of four renderings spread over that time. 0 for images without motion blur.
    pub motion_blur_s: f64,
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
    /// Kinect's focal length, no noise, nothing over the lens, draft colours taken at the same time as depth.
    pub fn new(path: Path) -> Self {
        let duration_s = path.default_duration_s();
        Self {
            camera: Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5),
            path,
            scene: path.scene(),
            duration_s,
            frames: (duration_s * 30.0).round() as u32,
            turns_back: false,
            frame_rate_hz: 30.0,
            noise: None,
            cover: None,
            colour: true,
            exposure: None,
            colour_delay_s: 0.0,
            motion_blur_s: 0.0,
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

    /// The same frames, and then all but the last again from the last to the first, so that the last frame sees what the
    /// first one saw: with time stamps that go on, with noise and exposure of their own, and a cover where it was.
    ///
    /// A camera that is not at rest where it turns back does so from one moment to the next: the gyroscope's readings
    /// jump there, and no accelerometer's reading has the jolt.
    pub fn there_and_back(mut self) -> Self {
        self.frames = (2 * self.frames).saturating_sub(1);
        self.turns_back = true;
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
        let (delay, blur) = (self.colour_delay_s, self.motion_blur_s);
        // The clock starts at one second, and time stamps are not negative.
        if !(-0.5..=0.5).contains(&delay) {
            let name = "the delay of colour in seconds";
            return Err(Error::Value { name, expected: "between -0.5 and 0.5", found: delay });
        }
        if !(0.0..=0.5).contains(&blur) {
            let name = "the shutter's time in seconds";
            return Err(Error::Value { name, expected: "between 0 and 0.5", found: blur });
        }
        self.cover.as_ref().map_or(Ok(()), Cover::validate)?;
        self.exposure.as_ref().map_or(Ok(()), Exposure::validate)
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
    /// A recording of the scene that the specification names.
    ///
    /// # Errors
    /// Where a number of the specification cannot be meant, or the path does not lead through the scene.
    pub fn new(spec: Spec) -> Result<Self, Error> {
        let Spec { path, scene, .. } = spec;
        if !path.scenes().contains(&scene) {
            return Err(Error::Scene { path, found: scene, expected: path.scene() });
        }
        spec.validate()?;
        Ok(Self { spec, scene: scene.scene() })
    }

    /// A recording of another scene than the specification names, through which the path must lead.
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

    /// The scene: what stays of it, without what is carried through it ([`Path::carried`]).
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene with what is carried through it at a time from the start of the recording.
    fn scene_at(&self, time_s: f64) -> Cow<'_, Scene> {
        let carried = self.spec.path.carried(self.path_seconds(time_s), self.spec.duration_s);
        if carried.is_empty() { Cow::Borrowed(&self.scene) } else { Cow::Owned(self.scene.and(carried)) }
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
        self.pose_at(self.seconds(index))
    }

    /// Exact pose at a time from the start of the recording.
    fn pose_at(&self, time_s: f64) -> Se3 {
        self.spec.path.world_from_camera(self.path_seconds(time_s), self.spec.duration_s)
    }

    /// Seconds from the start of the path to where it is at a time from the start of the recording.
    fn path_seconds(&self, time_s: f64) -> f64 {
        if self.is_on_way_back(time_s) { 2.0 * self.turning_seconds() - time_s } else { time_s }
    }

    fn is_on_way_back(&self, time_s: f64) -> bool {
        self.spec.turns_back && time_s > self.turning_seconds()
    }

    /// Half of the time from the first frame to the last.
    fn turning_seconds(&self) -> f64 {
        0.5 * self.seconds(self.spec.frames.saturating_sub(1))
    }

    /// Exact poses of all frames.
    pub fn trajectory(&self) -> Trajectory {
        (0..self.spec.frames)
            .map(|i| StampedPose { timestamp: self.timestamp(i), world_from_camera: self.world_from_camera(i) })
            .collect()
    }

    /// When a frame's colour is taken.
    pub fn colour_timestamp(&self, index: u32) -> Timestamp {
        Timestamp(self.timestamp(index).0 + (self.spec.colour_delay_s * 1e9).round() as i64)
    }

    /// What exposure makes of a frame's colours.
    pub fn brightness(&self, index: u32) -> Brightness {
        let unchanged = Brightness { gain: 1.0, offset: 0.0 };
        let time_s = self.seconds(index) + self.spec.colour_delay_s;
        self.spec.exposure.map_or(unchanged, |e| e.brightness(self.spec.seed, u64::from(index), time_s))
    }

    /// Share of a frame's depth image that is hidden by what is over the lens.
    pub fn covered_share(&self, index: u32) -> f64 {
        self.covered_at(self.seconds(index))
    }

    /// A frame: depth in metres, with noise if that was asked for, colour, the exact pose, and the gyroscope's readings
    /// after the frame before until this one (for the first frame, the one at its time). Where the lens is covered, depth
    /// is 0 and colour dark, black where all of it is covered.
    pub fn frame(&self, index: u32) -> Frame {
        let Spec { camera, quality, seed, .. } = self.spec;
        let world_from_camera = self.world_from_camera(index);
        let covered = self.covered_share(index);
        let scene = self.scene_at(self.seconds(index));
        let together = self.spec.colour_delay_s == 0.0 && self.spec.motion_blur_s == 0.0;
        let (mut depth, colour) = if covered >= 1.0 {
            (Image::filled(camera.width, camera.height, 0.0), None)
        } else if self.spec.colour && together {
            let Rendering { depth, normals, colour } = render(&scene, &camera, &world_from_camera, quality);
            (self.sense(depth, &normals, index), Some(colour))
        } else {
            let (depth, normals) = render_depth(&scene, &camera, &world_from_camera);
            (self.sense(depth, &normals, index), None)
        };
        if covered > 0.0 && covered < 1.0 {
            cover_depth(&mut depth, covered, seed);
        }
        let colour = self.spec.colour.then(|| self.finish_colour(colour, index));
        let mut frame = Frame::new(u64::from(index), self.timestamp(index), DepthImage::Metres(depth), colour)
            .at_pose(world_from_camera);
        frame.colour_timestamp = self.spec.colour.then(|| self.colour_timestamp(index));
        frame.gyroscope = self.gyroscope(index);
        frame
    }

    /// A frame's colour with what covers it and its exposure, from what was rendered already or nothing.
    fn finish_colour(&self, rendered: Option<ColourImage>, index: u32) -> ColourImage {
        let time_s = self.seconds(index) + self.spec.colour_delay_s;
        let covered = self.covered_at(time_s);
        let mut colour = match rendered {
            Some(colour) => colour,
            None if covered >= 1.0 => Image::filled(self.spec.camera.width, self.spec.camera.height, [0, 0, 0, 255]),
            None => self.colour_at(time_s),
        };
        if covered > 0.0 && covered < 1.0 {
            cover_colour(&mut colour, covered, self.spec.seed);
        }
        if self.spec.exposure.is_some() {
            self.brightness(index).apply_to(&mut colour);
        }
        colour
    }

    /// Colour as the camera sees it around a time.
    fn colour_at(&self, time_s: f64) -> ColourImage {
        let Spec { camera, quality, motion_blur_s, .. } = self.spec;
        let at = |time_s: f64| render_colour(&self.scene_at(time_s), &camera, &self.pose_at(time_s), quality);
        if motion_blur_s == 0.0 {
            return at(time_s);
        }
        let images = [-0.375, -0.125, 0.125, 0.375].map(|share| at(time_s + share * motion_blur_s));
        // Light adds up, not its square roots.
        let linear: [f32; 256] = std::array::from_fn(|v| colour(v as u32).z);
        Image::from_fn(camera.width, camera.height, |x, y| {
            let light = |channel: usize| images.iter().map(|i| linear[usize::from(i[(x, y)][channel])]).sum::<f32>();
            let [r, g, b] = to_srgb(0.25 * Vec3::new(light(0), light(1), light(2)));
            [r, g, b, 255]
        })
    }

    /// Share of the image that is hidden at a time from the start of the recording.
    fn covered_at(&self, time_s: f64) -> f64 {
        let cover = self.spec.cover.or(self.spec.path.cover());
        cover.map_or(0.0, |cover| cover.share(self.path_seconds(time_s), self.spec.duration_s))
    }

    /// All frames in order.
    pub fn frames(&self) -> impl ExactSizeIterator<Item = Frame> + '_ {
        (0..self.spec.frames).map(|i| self.frame(i))
    }

    /// Inertial readings from the first frame to the last.
    pub fn inertial(&self) -> Vec<InertialReading> {
        let count = self.readings_until(self.timestamp(self.spec.frames.max(1) - 1));
        (0..count).map(|i| self.reading(i)).collect()
    }

    /// The gyroscope's readings after the frame before until a frame.
    fn gyroscope(&self, index: u32) -> Vec<AngularRate> {
        let first = index.checked_sub(1).map_or(0, |before| self.readings_until(self.timestamp(before)));
        let range: Range<u64> = first..self.readings_until(self.timestamp(index));
        range
            .map(|i| self.reading(i))
            .map(|reading| AngularRate { timestamp: reading.timestamp, rad_per_s: reading.gyroscope })
            .collect()
    }

    /// Inertial reading number `i`, with the noise that was asked for.
    fn reading(&self, i: u64) -> InertialReading {
        let Spec { path, duration_s, inertial_noise, seed, .. } = self.spec;
        let time_s = self.reading_seconds(i);
        let mut exact = inertial::reading(path, self.path_seconds(time_s), duration_s, self.reading_timestamp(i));
        if self.is_on_way_back(time_s) {
            // Played backwards, a motion turns the other way; what accelerates it stays.
            exact.gyroscope = -exact.gyroscope;
        }
        inertial_noise.map_or(exact, |noise| noise.apply(exact, seed, i))
    }

    fn reading_seconds(&self, i: u64) -> f64 {
        i as f64 / self.spec.inertial_rate_hz
    }

    fn reading_timestamp(&self, i: u64) -> Timestamp {
        Timestamp(START.0 + (self.reading_seconds(i) * 1e9).round() as i64)
    }

    /// Number of inertial readings until a time, that time included.
    fn readings_until(&self, time: Timestamp) -> u64 {
        // Nearly; time stamps, which are rounded, decide.
        let mut count = ((time.0 - START.0) as f64 * 1e-9 * self.spec.inertial_rate_hz) as u64;
        while count > 0 && self.reading_timestamp(count - 1) > time {
            count -= 1;
        }
        while self.reading_timestamp(count) <= time {
            count += 1;
        }
        count
    }

    fn sense(&self, depth: Image<f32>, normals: &Image<Vec3>, index: u32) -> Image<f32> {
        match &self.spec.noise {
            Some(noise) => noise.apply(&depth, normals, &self.spec.camera, self.spec.seed, u64::from(index)),
            None => depth,
        }
    }

    /// Seconds from the start of the recording to a frame.
    fn seconds(&self, index: u32) -> f64 {
        f64::from(index) / self.spec.frame_rate_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Covering;
    use crate::inertial::GRAVITY_WORLD;
    use glam::{DVec2, DVec3};

    fn metres(frame: &Frame) -> &Image<f32> {
        let DepthImage::Metres(depth) = &frame.depth else { panic!("metres") };
        depth
    }

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
            Spec { colour_delay_s: f64::NAN, ..good },
            Spec { motion_blur_s: -0.01, ..good },
            Spec { cover: Some(Cover { covering: Covering::Partly(1.1), during: [0.0, 1.0] }), ..good },
            Spec { cover: Some(Cover { during: [0.6, 0.4], ..Cover::WHOLLY }), ..good },
            Spec { exposure: Some(Exposure { gain: [1.0, 0.5], ..Exposure::AUTO }), ..good },
            Spec { exposure: Some(Exposure { offset: f64::NAN, ..Exposure::AUTO }), ..good },
        ];
        for spec in bad {
            assert!(matches!(Sequence::new(spec), Err(Error::Value { .. })));
        }
        assert!(matches!(Sequence::new(good.with_size(0, 480)), Err(Error::Camera(_))));
        let elsewhere = Sequence::new(Spec { scene: SceneName::Hall, ..good }).unwrap_err().to_string();
        assert!(elsewhere.contains("arc") && elsewhere.contains("hall") && elsewhere.contains("room"), "{elsewhere}");
    }

    #[test]
    fn surfaces_are_where_a_depth_camera_sees_them() {
        for path in
            Path::ALL.into_iter().filter(|p| !matches!(p, Path::Hall | Path::Corridor | Path::Eight | Path::Rooms))
        {
            let sequence = Sequence::new(Spec::new(path).with_size(40, 30)).unwrap();
            let (mut pixels, mut near) = (0usize, 0usize);
            for i in (0..sequence.spec().frames).step_by(10) {
                if sequence.covered_share(i) > 0.0 {
                    continue;
                }
                let frame = sequence.frame(i);
                let DepthImage::Metres(depth) = &frame.depth else { panic!("metres") };
                let good = depth.data().iter().filter(|z| (0.6..3.0).contains(*z)).count();
                assert!(good * 4 > depth.data().len() * 3, "{path}: {good} pixels of frame {i} between 0.6 and 3 m");
                pixels += depth.data().len();
                near += good;
            }
            assert!(near * 100 > pixels * 94, "{path}: {near} of {pixels}");
        }
    }

    #[test]
    fn the_wall_path_sees_nothing_but_a_plane_for_a_third_of_the_time() {
        for scene in [SceneName::Wall, SceneName::BlankWall] {
            let mut spec = Spec::new(Path::Wall).with_size(32, 24);
            (spec.scene, spec.colour) = (scene, false);
            let sequence = Sequence::new(spec).unwrap();
            let camera = spec.camera;
            let only_wall: Vec<bool> = (0..spec.frames)
                .step_by(5)
                .map(|i| {
                    let frame = sequence.frame(i);
                    let (depth, pose) = (metres(&frame), frame.world_from_camera.unwrap());
                    let wall = |x: u32, y: u32| {
                        let z = f64::from(depth[(x, y)]);
                        let point = pose.transform_point(camera.unproject(DVec2::new(x.into(), y.into()), z));
                        z > 0.0 && (point.z - 2.0).abs() < 1e-3
                    };
                    (0..24).all(|y| (0..32).all(|x| wall(x, y)))
                })
                .collect();
            let middle = only_wall.len() / 3..only_wall.len() * 2 / 3;
            assert!(only_wall[middle].iter().all(|wall| *wall), "{only_wall:?}");
            let share = only_wall.iter().filter(|wall| **wall).count() as f64 / only_wall.len() as f64;
            assert!((0.33..0.5).contains(&share), "{share} of the time");
            for end in [0, spec.frames - 1] {
                let frame = sequence.frame(end);
                let (depth, pose) = (metres(&frame), frame.world_from_camera.unwrap());
                let off_wall = (0..24 * 32).filter(|i| {
                    let (x, y) = (i % 32, i / 32);
                    let ray = camera.unproject(DVec2::new(x.into(), y.into()), depth[(x, y)].into());
                    pose.transform_point(ray).z < 1.9
                });
                assert!(off_wall.count() > 24 * 32 / 2, "furniture fills the view at frame {end}");
            }
            let moved =
                sequence.world_from_camera(100).translation.distance(sequence.world_from_camera(200).translation);
            assert!(moved > 1.2, "{moved} m along the wall");
        }
    }

    #[test]
    fn much_of_the_hall_is_three_to_six_metres_away_and_a_kinect_still_sees_enough() {
        let spec = Spec { colour: false, ..Spec::new(Path::Hall).with_size(40, 30).with_noise(DepthNoise::KINECT, 1) };
        let (kinect, exact) = (Sequence::new(spec).unwrap(), Sequence::new(Spec { noise: None, ..spec }).unwrap());
        let (mut pixels, mut far) = (0usize, 0usize);
        for i in (0..spec.frames).step_by(20) {
            let (frame, seen) = (exact.frame(i), kinect.frame(i));
            let depth = metres(&frame).data();
            assert!(depth.iter().all(|z| (0.6..9.0).contains(z)), "frame {i}");
            pixels += depth.len();
            far += depth.iter().filter(|z| (3.0..6.0).contains(*z)).count();
            let valid = metres(&seen).data().iter().filter(|z| **z > 0.0).count();
            assert!(valid * 4 > depth.len(), "frame {i}: {valid} of {}", depth.len());
        }
        let share = far as f64 / pixels as f64;
        assert!((0.35..0.8).contains(&share), "{share}");
    }

    #[test]
    fn a_partly_covered_lens_hides_the_share_that_was_asked_for() {
        let mut spec = Spec::new(Path::Loop).with_size(40, 30);
        for (cover, share) in
            [(Cover::PARTLY, 0.6), (Cover { covering: Covering::Partly(0.25), ..Cover::PARTLY }, 0.25)]
        {
            spec.cover = Some(cover);
            let sequence = Sequence::new(spec).unwrap();
            let free = Sequence::new(Spec { cover: None, ..spec }).unwrap();
            let frame = sequence.frame(200);
            let hidden = metres(&frame).data().iter().filter(|z| **z == 0.0).count();
            assert_eq!(hidden, (share * 1200.0) as usize);
            let (unhidden, colour) = (free.frame(200), frame.colour.as_ref().unwrap());
            for (i, z) in metres(&frame).data().iter().enumerate() {
                if *z == 0.0 {
                    assert!(colour.data()[i][..3].iter().all(|c| *c < 50), "a hand is dark");
                } else {
                    assert_eq!(*z, metres(&unhidden).data()[i]);
                    assert_eq!(colour.data()[i], unhidden.colour.as_ref().unwrap().data()[i]);
                }
            }
            assert_eq!(sequence.frame(100).depth, free.frame(100).depth);
        }
    }

    #[test]
    fn a_gradually_covered_lens_goes_dark_and_comes_back() {
        let spec = Spec { cover: Some(Cover::GRADUALLY), ..Spec::new(Path::Arc).with_size(20, 15) };
        let sequence = Sequence::new(spec).unwrap();
        let dark: Vec<usize> =
            sequence.frames().map(|frame| metres(&frame).data().iter().filter(|z| **z == 0.0).count()).collect();
        for (i, dark) in dark.iter().enumerate() {
            assert_eq!(*dark, (300.0 * sequence.covered_share(i as u32)).round() as usize, "frame {i}");
        }
        assert_eq!((dark[17], dark[33], dark[49]), (0, 300, 0));
        assert!(dark[18..27].is_sorted() && dark[40..49].iter().rev().is_sorted(), "{dark:?}");
        assert!(dark.iter().filter(|d| (1..300).contains(*d)).count() >= 16, "{dark:?}");
    }

    #[test]
    fn exposure_changes_colours_as_it_says_and_nothing_else() {
        let fixed = Spec::new(Path::Loop).with_size(40, 30);
        let auto = Sequence::new(Spec { exposure: Some(Exposure::AUTO), ..fixed }).unwrap();
        let fixed = Sequence::new(fixed).unwrap();
        for i in [0, 1, 70, 150] {
            let Brightness { gain, offset } = auto.brightness(i);
            let (a, b) = (auto.frame(i), fixed.frame(i));
            assert_eq!(a.depth, b.depth);
            for (a, b) in a.colour.unwrap().data().iter().zip(b.colour.unwrap().data()) {
                for c in 0..3 {
                    let expected = (f64::from(b[c]) * gain + offset).round().clamp(0.0, 255.0);
                    assert_eq!(f64::from(a[c]), expected);
                }
                assert_eq!(a[3], 255);
            }
        }
        assert_eq!(fixed.brightness(5), Brightness { gain: 1.0, offset: 0.0 });
    }

    #[test]
    fn delayed_colour_is_seen_from_where_the_camera_is_then() {
        let at_once = Spec::new(Path::Loop).with_size(40, 30);
        for frames_later in [1, -1] {
            let delayed = Spec { colour_delay_s: f64::from(frames_later) / 30.0, ..at_once };
            let (delayed, at_once) = (Sequence::new(delayed).unwrap(), Sequence::new(at_once).unwrap());
            let frame = delayed.frame(7);
            let (same, later) = (at_once.frame(7), at_once.frame((7 + frames_later) as u32));
            assert_eq!(
                (&frame.depth, frame.timestamp, frame.world_from_camera),
                (&same.depth, same.timestamp, same.world_from_camera)
            );
            assert_eq!(frame.colour, later.colour);
            let apart = frame.colour_timestamp.unwrap().0 - frame.timestamp.0;
            assert!((apart - i64::from(frames_later) * 33_333_333).abs() <= 1, "{apart} ns");
            assert_eq!(same.colour_timestamp, Some(same.timestamp));
        }
    }

    #[test]
    fn motion_blurs_colour_and_rest_does_not() {
        let blurred = |path: Path, index: u32| {
            let spec = Spec::new(path).with_size(80, 60);
            let sharp = Sequence::new(spec).unwrap().frame(index);
            let frame = Sequence::new(Spec { motion_blur_s: 0.03, ..spec }).unwrap().frame(index);
            assert_eq!(frame.depth, sharp.depth);
            // Differences of neighbours: blur takes them away.
            let contrast = |image: &ColourImage| {
                image.data().windows(2).map(|p| f64::from(p[0][1].abs_diff(p[1][1]))).sum::<f64>()
            };
            contrast(&frame.colour.unwrap()) / contrast(&sharp.colour.unwrap())
        };
        assert!(blurred(Path::Fast, 40) < 0.9);
        assert!((blurred(Path::Arc, 0) - 1.0).abs() < 0.03, "the arc starts at rest");
    }

    #[test]
    fn frames_without_colour_have_the_same_depth() {
        let spec = Spec::new(Path::Loop).with_size(40, 30).with_noise(DepthNoise::KINECT, 2);
        let without = Sequence::new(Spec { colour: false, ..spec }).unwrap().frame(3);
        assert_eq!(without.depth, Sequence::new(spec).unwrap().frame(3).depth);
        assert!(without.colour.is_none() && without.colour_timestamp.is_none());
    }

    #[test]
    fn each_frame_has_the_gyroscopes_readings_since_the_one_before() {
        for (frame_rate_hz, inertial_rate_hz) in [(30.0, 200.0), (29.97, 119.3), (60.0, 25.0), (30.0, 30.0)] {
            let spec = Spec {
                frame_rate_hz,
                inertial_rate_hz,
                inertial_noise: Some(InertialNoise::PHONE),
                seed: 5,
                ..Spec::new(Path::Fast).with_size(2, 2).with_frames(31)
            };
            let sequence = Sequence::new(spec).unwrap();
            let all: Vec<AngularRate> = sequence
                .inertial()
                .into_iter()
                .map(|r| AngularRate { timestamp: r.timestamp, rad_per_s: r.gyroscope })
                .collect();
            assert_eq!(sequence.frames().flat_map(|frame| frame.gyroscope).collect::<Vec<_>>(), all);
            assert_eq!(sequence.frame(0).gyroscope, all[..1]);
            for i in 1..31 {
                let since = sequence.timestamp(i - 1)..=sequence.timestamp(i);
                let readings = sequence.frame(i).gyroscope;
                assert!(readings.iter().all(|r| since.contains(&r.timestamp) && r.timestamp != *since.start()));
            }
        }
    }
}
