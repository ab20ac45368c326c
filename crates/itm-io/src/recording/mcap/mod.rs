//! MCAP: files of time-stamped messages, as robots record them (<https://mcap.dev>), without any of ROS.
//!
//! Images, cameras, poses and trees of frames are read in ROS 2's messages (CDR) and in Foxglove's (protobuf). Messages are
//! found by their schemas; [`Topics`] chooses where several would do.

mod cdr;
mod container;
mod foxglove;
mod messages;
mod pixels;
mod topics;
mod transforms;
mod write;

use std::path::{Path, PathBuf};

use itm_core::{
    AngularRate, Calibration, DepthConversion, Distortion, Frame, Intrinsics, Se3, StampedPose, Timestamp, Trajectory,
};

use self::container::{Container, ImageAt, Index, Topic};
use self::messages::{CameraInfo, ImageMessage, Kind, Purpose};
use self::pixels::Sample;
use self::topics::{Candidate, Choice, PoseSource};
use self::transforms::{Frames, frame_name, interpolate};
use super::{Format, OpenOptions, Recording, RecordingInfo, readings_by_frame, tum};
use crate::{Error, calibration};

pub use topics::Topics;
pub use write::McapWriter;

/// Name of the metadata that [`McapWriter`] leaves, for what messages have no room for.
const METADATA: &str = "itm";
/// Its entry for what stamps are, and its value where they only count images.
const TIME_KEY: &str = "time";
const NOMINAL_TIME: &str = "nominal";
/// Its entry for the largest distance in time between depth and colour of a frame.
const TOLERANCE_KEY: &str = "colour_tolerance_ns";

/// Depth and colour may lie at least so far apart, however fast the camera is.
const TOLERANCE_NS: i64 = 20_000_000;
/// So many damaged images at a topic's beginning are passed over to find out what it has.
const LOOKED_AT: usize = 16;

/// The file's ending, and how a file begins.
pub(super) fn recognised(path: &Path) -> bool {
    path.extension().is_some_and(|end| end.eq_ignore_ascii_case("mcap")) || container::begins_as_mcap(path)
}

/// A frame's messages.
struct FrameAt {
    timestamp: Timestamp,
    /// Numbers of the depth image's and of the colour image's message within their topics.
    depth: usize,
    colour: Option<usize>,
    world_from_camera: Option<Se3>,
    gyroscope: Vec<AngularRate>,
}

/// Images of one topic.
struct Images {
    topic: String,
    kind: Kind,
    at: Vec<ImageAt>,
}

/// An MCAP file.
pub(super) struct McapRecording {
    path: PathBuf,
    container: Container,
    info: RecordingInfo,
    depth: Images,
    colour: Option<Images>,
    frames: Vec<FrameAt>,
}

/// Opens an MCAP file; `calibration_beside` is a calibration file that lies in the same folder, where that was named.
pub(super) fn open(
    path: &Path,
    calibration_beside: Option<PathBuf>,
    options: &OpenOptions,
) -> Result<McapRecording, Error> {
    let (mut container, index) = Container::open(path)?;
    for warning in warnings(&index) {
        tracing::warn!("'{}': {warning}", path.display());
    }
    let topics = index.topics.as_slice();
    let choice = Choice { path, topics, wanted: &options.topics };
    let candidates = candidates(path, &mut container, topics)?;
    let depth = choice.depth(&candidates)?;
    let colour = choice.colour(&candidates, depth)?;

    let frames = Frames::new(topics.iter().flat_map(|topic| {
        let fixed = topic.name.ends_with("tf_static");
        topic.transforms.iter().filter(|_| topic.is_for(Purpose::Transforms)).map(move |transform| (fixed, transform))
    }));
    if !frames.with_two_parents.is_empty() {
        let names = frames.with_two_parents.join(", ");
        tracing::warn!("'{}': frames with two parents, of which the first counts: {names}", path.display());
    }
    let depth_images = Images::new(depth, path);
    let colour_images = colour.map(|colour| Images::new(colour, path));
    let first = depth_images.at.iter().map(|image| image.stamp).min().unwrap_or(Timestamp(0));
    let (calibration, calibration_source) = match options.calibration.clone().or(calibration_beside) {
        Some(file) => read_calibration(path, &file, depth, colour)?,
        None => calibration_of(&choice, &frames, depth, colour, first)?,
    };

    let metadata = |key| index.metadata.get(METADATA).and_then(|metadata| metadata.get(key));
    let tolerance_ns = metadata(TOLERANCE_KEY).and_then(|text| text.parse().ok());
    let tolerance_ns = tolerance_ns.unwrap_or_else(|| (period_ns(&depth_images.at) / 2).max(TOLERANCE_NS));
    let mut pairs = pair(path, &depth_images, colour_images.as_ref(), tolerance_ns)?;
    if metadata(TOLERANCE_KEY).is_some() {
        add_unpaired(&mut pairs, &depth_images);
    }
    let depth_without_colour = depth_images.at.len() - pairs.len();
    if depth_without_colour > 0 {
        tracing::warn!(
            "{depth_without_colour} depth images of '{}' have no colour image close in time and are left out",
            path.display()
        );
    }

    let poses = Poses::find(&choice, &frames, &depth.sample.frame)?;
    let readings = choice.imu()?.map(|imu| gyroscope(&topics[imu]));
    let stamps: Vec<Timestamp> = pairs.iter().map(|&(depth, _)| depth_images.at[depth].stamp).collect();
    let by_frame = readings_by_frame(readings.as_deref().unwrap_or_default(), &stamps);
    let frame = |((&(depth, colour), &timestamp), gyroscope)| FrameAt {
        timestamp,
        depth,
        colour,
        world_from_camera: poses.at(&frames, timestamp),
        gyroscope,
    };
    let frames: Vec<FrameAt> = pairs.iter().zip(&stamps).zip(by_frame).map(frame).collect();
    let name = path.file_stem().map(|name| name.to_string_lossy().into_owned());
    let info = RecordingInfo {
        name: name.unwrap_or_else(|| path.display().to_string()),
        format: Format::Mcap,
        calibration,
        calibration_source,
        frames: frames.len(),
        depth_without_colour,
        has_timestamps: metadata(TIME_KEY).is_none_or(|time| time != NOMINAL_TIME),
        has_colour: colour_images.is_some(),
        has_gyroscope: readings.is_some(),
        has_imu_orientation: false,
        ground_truth: poses.truth,
    };
    Ok(McapRecording { path: path.to_path_buf(), container, info, depth: depth_images, colour: colour_images, frames })
}

/// What a user should know of a file before frames are read.
fn warnings(index: &Index) -> Vec<String> {
    let mut warnings = index.warnings.clone();
    for topic in &index.topics {
        if let Some(reason) = &topic.damage {
            let Topic { name, damaged, count, .. } = topic;
            warnings.push(format!("{damaged} of {count} messages of '{name}' are left out; the first: {reason}"));
        }
        if topic.camera_changes {
            let name = &topic.name;
            warnings
                .push(format!("the camera described by '{name}' changes; its first description is used throughout"));
        }
    }
    warnings
}

/// The topics of images, each with its first image that can be read.
fn candidates<'a>(path: &Path, container: &mut Container, topics: &'a [Topic]) -> Result<Vec<Candidate<'a>>, Error> {
    let mut candidates = Vec::new();
    for (index, topic) in topics.iter().enumerate() {
        let Some(kind) = topic.kind.filter(|kind| kind.purpose() == Purpose::Image) else { continue };
        let mut first_reason = None;
        let mut found = None;
        for image in topic.images.iter().take(LOOKED_AT) {
            let payload = container.read(image.place)?;
            match kind.image(&payload).and_then(|message| Sample::of(&message)) {
                Ok(sample) => {
                    found = Some(sample);
                    break;
                }
                Err(reason) => first_reason = first_reason.or(Some(reason)),
            }
        }
        match (found, first_reason) {
            (Some(sample), _) => candidates.push(Candidate { index, topic, sample }),
            (None, Some(reason)) => {
                tracing::warn!("'{}': the images of '{}' cannot be read: {reason}", path.display(), topic.name);
            }
            // A topic without messages.
            (None, None) => {}
        }
    }
    Ok(candidates)
}

impl Images {
    fn new(candidate: &Candidate<'_>, path: &Path) -> Self {
        let topic = candidate.topic;
        let mut at = topic.images.clone();
        // A driver that sets no stamps leaves them at zero.
        if at.len() > 1 && at.iter().all(|image| image.stamp == at[0].stamp) {
            tracing::warn!(
                "'{}': the messages of '{}' all have the same stamp; the times at which they were recorded are used",
                path.display(),
                topic.name
            );
            for image in &mut at {
                image.stamp = image.log_time;
            }
        }
        let kind = topic.kind.unwrap_or(Kind::RosImage);
        Self { topic: topic.name.clone(), kind, at }
    }

    fn stamps(&self) -> Vec<Timestamp> {
        self.at.iter().map(|image| image.stamp).collect()
    }
}

/// The usual time between images.
fn period_ns(images: &[ImageAt]) -> i64 {
    let mut stamps: Vec<i64> = images.iter().map(|image| image.stamp.0).collect();
    stamps.sort_unstable();
    let mut steps: Vec<i64> = stamps.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied().unwrap_or(0)
}

/// Numbers of depth and colour images that belong together, in the order of the depth images' times.
fn pair(
    path: &Path,
    depth: &Images,
    colour: Option<&Images>,
    tolerance_ns: i64,
) -> Result<Vec<(usize, Option<usize>)>, Error> {
    let depth_times = depth.stamps();
    let Some(colour) = colour else {
        let mut order: Vec<usize> = (0..depth_times.len()).collect();
        order.sort_by_key(|&at| (depth_times[at], at));
        return Ok(order.into_iter().map(|at| (at, None)).collect());
    };
    let colour_times = colour.stamps();
    let pairs = tum::associate(&depth_times, &colour_times, tolerance_ns);
    if pairs.is_empty() {
        let closest_s = tum::closest_s(&depth_times, &colour_times);
        return Err(Error::Topics {
            path: path.to_path_buf(),
            problem: format!(
                "none of the {} depth images of '{}' was taken within {:.1} ms of one of the {} colour images of '{}'; the \
                 closest two are {closest_s} s apart",
                depth_times.len(),
                depth.topic,
                tolerance_ns as f64 * 1e-6,
                colour_times.len(),
                colour.topic
            ),
            candidates: Vec::new(),
            advice: "choose others with --topics color=TOPIC, or color=none".into(),
        });
    }
    Ok(pairs.into_iter().map(|(depth, colour)| (depth, Some(colour))).collect())
}

/// Adds depth images without colour. [`McapWriter`] writes none but those whose frame had no colour where it came from.
fn add_unpaired(pairs: &mut Vec<(usize, Option<usize>)>, depth: &Images) {
    let mut paired = vec![false; depth.at.len()];
    for &(depth, _) in &*pairs {
        paired[depth] = true;
    }
    pairs.extend((0..depth.at.len()).filter(|&at| !paired[at]).map(|at| (at, None)));
    pairs.sort_by_key(|&(at, _)| (depth.at[at].stamp, at));
}

fn read_calibration(
    path: &Path,
    file: &Path,
    depth: &Candidate<'_>,
    colour: Option<&Candidate<'_>>,
) -> Result<(Calibration, String), Error> {
    let calibration = calibration::read(file)?;
    let check = |candidate: &Candidate<'_>, camera: &Intrinsics| {
        let (expected, found) = ((camera.width, camera.height), candidate.sample.size);
        if expected == found {
            return Ok(());
        }
        let reason = format!(
            "expected images of {}x{} pixels as in the calibration file '{}', found {}x{}",
            expected.0,
            expected.1,
            file.display(),
            found.0,
            found.1
        );
        Err(Error::McapTopic { path: path.to_path_buf(), topic: candidate.topic.name.clone(), reason })
    };
    check(depth, &calibration.depth)?;
    if let Some(colour) = colour {
        check(colour, &calibration.colour)?;
    }
    Ok((calibration, format!("calibration file '{}'", file.display())))
}

/// The cameras as messages describe them.
fn calibration_of(
    choice: &Choice<'_>,
    frames: &Frames,
    depth: &Candidate<'_>,
    colour: Option<&Candidate<'_>>,
    time: Timestamp,
) -> Result<(Calibration, String), Error> {
    let path = choice.path;
    let camera = |image: &Candidate<'_>, at: usize| -> Result<(Intrinsics, Distortion), Error> {
        let topic = &choice.topics[at];
        let failed = |reason| Error::McapTopic { path: path.to_path_buf(), topic: topic.name.clone(), reason };
        let info: &CameraInfo = topic.camera.as_ref().ok_or_else(|| failed("it has no message".into()))?;
        info.camera(image.sample.size, image.is_rectified()).map_err(failed)
    };
    let depth_at = choice.info(depth, "depth_info", choice.wanted.depth_info.as_deref())?;
    let (depth_camera, depth_distortion) = camera(depth, depth_at)?;
    let registered = Calibration {
        depth_distortion,
        colour_distortion: depth_distortion,
        ..Calibration::registered(depth_camera, DepthConversion::MILLIMETRES)
    };
    let mut source = format!("messages of '{}'", choice.topics[depth_at].name);
    let calibration = match colour {
        None => registered,
        Some(colour) => {
            let colour_at = choice.info(colour, "color_info", choice.wanted.colour_info.as_deref())?;
            let (colour_camera, colour_distortion) = camera(colour, colour_at)?;
            if colour_at != depth_at {
                source += &format!(" and '{}'", choice.topics[colour_at].name);
            }
            let colour_from_depth = colour_from_depth(path, frames, depth, colour, time);
            Calibration { colour: colour_camera, colour_distortion, colour_from_depth, ..registered }
        }
    };
    let failed = |reason| Error::Calibration { path: path.to_path_buf(), reason };
    calibration.validate().map_err(failed)?;
    Ok((calibration, source))
}

fn colour_from_depth(
    path: &Path,
    frames: &Frames,
    depth: &Candidate<'_>,
    colour: &Candidate<'_>,
    time: Timestamp,
) -> Se3 {
    let (depth, colour) = (frame_name(&depth.sample.frame), frame_name(&colour.sample.frame));
    if depth == colour {
        return Se3::IDENTITY;
    }
    frames.a_from_b(colour, depth, time).unwrap_or_else(|| {
        tracing::warn!(
            "'{}': depth is in the frame '{depth}' and colour in '{colour}', and nothing says how these lie to each other; \
             they are taken for the same",
            path.display()
        );
        Se3::IDENTITY
    })
}

/// True poses of the depth camera.
struct Poses {
    /// The world's and the camera's frame, where poses follow from a tree.
    tree: Option<(String, String)>,
    truth: Option<Trajectory>,
}

impl Poses {
    fn find(choice: &Choice<'_>, frames: &Frames, camera: &str) -> Result<Self, Error> {
        let root = frames.moving_root(camera);
        Ok(match choice.pose(root.is_some())? {
            None => Self { tree: None, truth: None },
            Some(PoseSource::Topic(at)) => {
                let truth = of_topic(choice.path, &choice.topics[at], frames, camera);
                Self { tree: None, truth: (!truth.is_empty()).then_some(truth) }
            }
            Some(PoseSource::Tree) => {
                let Some(root) = root else {
                    return Err(Error::Topics {
                        path: choice.path.to_path_buf(),
                        problem: format!("no transform moves the depth camera's frame '{camera}'"),
                        candidates: Vec::new(),
                        advice: "choose other poses with --topics pose=TOPIC, or pose=none".into(),
                    });
                };
                let pose = |timestamp| {
                    let world_from_camera = frames.a_from_b(root, camera, timestamp)?;
                    Some(StampedPose { timestamp, world_from_camera })
                };
                let truth: Trajectory = frames.times(camera).into_iter().filter_map(pose).collect();
                Self { tree: Some((root.into(), camera.into())), truth: (!truth.is_empty()).then_some(truth) }
            }
        })
    }

    fn at(&self, frames: &Frames, time: Timestamp) -> Option<Se3> {
        if let Some((root, camera)) = &self.tree {
            return frames.a_from_b(root, camera, time);
        }
        interpolate(self.truth.as_ref()?.poses(), |pose| (pose.timestamp, pose.world_from_camera), time)
    }
}

/// The poses that a topic gives the camera: its own, or those of what it is fixed to.
fn of_topic(path: &Path, topic: &Topic, frames: &Frames, camera: &str) -> Trajectory {
    let mut unconnected = None;
    let poses = topic.transforms.iter().map(|transform| {
        let child_from_camera = match transform.child.as_deref().map(frame_name) {
            Some(child) if !child.is_empty() && child != frame_name(camera) => {
                let found = frames.a_from_b(child, camera, transform.stamp);
                if found.is_none() {
                    unconnected = Some(child);
                }
                found
            }
            _ => None,
        };
        // One motion keeps its bits.
        let pose = transform.parent_from_child;
        let world_from_camera = child_from_camera.map_or(pose, |child_from_camera| pose * child_from_camera);
        StampedPose { timestamp: transform.stamp, world_from_camera }
    });
    let trajectory = poses.collect();
    if let Some(child) = unconnected {
        tracing::warn!(
            "'{}': the poses of '{}' are those of the frame '{child}', and nothing says how the depth camera's frame \
             '{camera}' lies in it; they are taken for the camera's",
            path.display(),
            topic.name
        );
    }
    trajectory
}

fn gyroscope(topic: &Topic) -> Vec<AngularRate> {
    let mut readings: Vec<AngularRate> = topic
        .inertial
        .iter()
        .filter(|reading| reading.rad_per_s.is_finite())
        .map(|reading| AngularRate { timestamp: reading.stamp, rad_per_s: reading.rad_per_s })
        .collect();
    readings.sort_by_key(|reading| reading.timestamp);
    readings
}

impl McapRecording {
    fn image<T>(
        path: &Path,
        container: &mut Container,
        images: &Images,
        number: usize,
        decode: impl FnOnce(&ImageMessage<'_>) -> Result<T, String>,
    ) -> Result<T, Error> {
        let payload = container.read(images.at[number].place)?;
        images.kind.image(&payload).and_then(|message| decode(&message)).map_err(|reason| Error::Message {
            path: path.to_path_buf(),
            topic: images.topic.clone(),
            message: number,
            reason,
        })
    }
}

impl Recording for McapRecording {
    fn info(&self) -> &RecordingInfo {
        &self.info
    }

    fn read(&mut self, index: usize) -> Result<Frame, Error> {
        let frame = self.frames.get(index).ok_or(Error::NoSuchFrame { index, frames: self.frames.len() })?;
        let Calibration { depth, colour, .. } = &self.info.calibration;
        let (depth_size, colour_size) = ((depth.width, depth.height), (colour.width, colour.height));
        let (path, container) = (&self.path, &mut self.container);
        let mut images = || {
            let depth =
                Self::image(path, container, &self.depth, frame.depth, |image| pixels::depth(image, depth_size))?;
            let colour = match (&self.colour, frame.colour) {
                (Some(images), Some(number)) => {
                    Some(Self::image(path, container, images, number, |image| pixels::colour(image, colour_size))?)
                }
                _ => None,
            };
            Ok((depth, colour))
        };
        let (depth, colour) = images().map_err(|reason| Error::Frame { index, reason: Box::new(reason) })?;
        let colour_timestamp = self.colour.as_ref().zip(frame.colour).map(|(images, number)| images.at[number].stamp);
        Ok(Frame {
            colour_timestamp,
            world_from_camera: frame.world_from_camera,
            gyroscope: frame.gyroscope.clone(),
            ..Frame::new(index as u64, frame.timestamp, depth, colour)
        })
    }

    fn timestamp(&self, index: usize) -> Option<Timestamp> {
        Some(self.frames.get(index)?.timestamp)
    }
}
