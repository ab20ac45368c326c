//! Any recording as MCAP with Foxglove's schemas.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use ::mcap::records::MessageHeader;
use ::mcap::{Compression, McapError, WriteOptions, Writer};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use itm_core::{
    AngularRate, Calibration, ColourImage, DepthConversion, DepthImage, Distortion, Frame, Intrinsics, Se3,
    StampedPose, Timestamp,
};
use prost::Message as _;

use super::foxglove::{self, CameraCalibration, CompressedImage, FrameTransform, PoseInFrame, RawImage};
use super::{METADATA, NOMINAL_TIME, TIME_KEY, TOLERANCE_KEY};
use crate::Error;
use crate::recording::RecordingInfo;
use crate::whole_file::WholeFile;

/// Names of frames: of the world, and of the two cameras.
const WORLD: &str = "world";
const DEPTH_CAMERA: &str = "depth_camera";
const COLOUR_CAMERA: &str = "color_camera";

/// `sensor_msgs/Imu` as MCAP holds ROS 2's schemas: Foxglove has none of its own.
const IMU_SCHEMA: &str = "\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
";

/// Writes frames to an MCAP file, losslessly, in chunks compressed by zstd.
///
/// | topic | schema | what |
/// | --- | --- | --- |
/// | `/depth/image` | `foxglove.RawImage` | 16UC1 where raw values are millimetres, else 32FC1 (metres) |
/// | `/color/image` | `foxglove.CompressedImage` | PNG |
/// | `/depth/calibration`, `/color/calibration` | `foxglove.CameraCalibration` | once, before the first image |
/// | `/ground_truth` | `foxglove.PoseInFrame` | true poses of the depth camera |
/// | `/tf` | `foxglove.FrameTransform` | the same of the cameras' frames, for viewers; how depth lies to colour |
/// | `/imu` | `sensor_msgs/msg/Imu` (CDR) | a gyroscope's readings |
///
/// Raw values of other units become metres by the formula of [`DepthConversion`] in single precision, as tracking would have
/// made them: a run over the file repeats one over the recording to the bit, unless raw values are disparities or have an
/// offset, where the last bit may differ. Poses of frames are those of the ground truth at their times, where it has such.
///
/// The file takes its name in [`McapWriter::finish`]; dropped before that it is removed, and a file of the name stays as it is.
///
/// ```no_run
/// use itm_io::recording::{self, McapWriter, OpenOptions};
///
/// let mut recording = recording::open("rgbd_dataset_freiburg1_desk".as_ref(), &OpenOptions::default())?;
/// let mut writer = McapWriter::create("desk.mcap".as_ref(), recording.info())?;
/// for index in 0..recording.info().frames {
///     writer.write(&recording.read(index)?)?;
/// }
/// writer.finish()?;
/// # Ok::<(), itm_io::Error>(())
/// ```
pub struct McapWriter {
    path: PathBuf,
    writer: Writer<WholeFile>,
    info: RecordingInfo,
    channels: Channels,
    sequences: BTreeMap<u16, u32>,
    /// Of the ground truth, those written.
    poses_written: usize,
    has_begun: bool,
    /// Largest distance in time between a frame's depth and colour.
    tolerance_ns: i64,
}

struct Channels {
    depth: u16,
    colour: Option<u16>,
    depth_info: u16,
    colour_info: Option<u16>,
    truth: Option<u16>,
    transforms: Option<u16>,
    imu: Option<u16>,
}

fn as_io(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

impl McapWriter {
    /// Starts a file for frames of a recording.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn create(path: &Path, info: &RecordingInfo) -> Result<Self, Error> {
        let failed = |reason| Error::io("write", path, reason);
        let file = WholeFile::create(path).map_err(failed)?;
        let options = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            // The same bytes on every machine.
            .compression_threads(0)
            .library(concat!("itm ", env!("CARGO_PKG_VERSION")));
        let start = || -> Result<_, McapError> {
            let mut writer = options.create(file)?;
            let channels = Channels::add(&mut writer, info)?;
            Ok((writer, channels))
        };
        let (writer, channels) = start().map_err(as_io).map_err(failed)?;
        Ok(Self {
            path: path.to_path_buf(),
            writer,
            info: info.clone(),
            channels,
            sequences: BTreeMap::new(),
            poses_written: 0,
            has_begun: false,
            tolerance_ns: 0,
        })
    }

    /// Writes a frame; frames come in the order of their times.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&mut self, frame: &Frame) -> Result<(), Error> {
        let time = frame.timestamp;
        if !self.has_begun {
            self.has_begun = true;
            self.write_cameras(time)?;
        }
        self.write_truth_until(Some(time))?;
        let transforms = self.channels.transforms;
        if let (Some(channel), Some(world_from_depth)) = (transforms, &frame.world_from_camera) {
            // A frame has one parent: depth hangs on colour, where there is colour.
            let (child, pose) = if self.channels.colour.is_some() {
                (COLOUR_CAMERA, *world_from_depth * self.info.calibration.colour_from_depth.inverse())
            } else {
                (DEPTH_CAMERA, *world_from_depth)
            };
            self.put(channel, time, &FrameTransform::new(time, WORLD, child, &pose).encode_to_vec())?;
            if self.info.ground_truth.is_none()
                && let Some(channel) = self.channels.truth
            {
                self.put(channel, time, &PoseInFrame::new(time, WORLD, world_from_depth).encode_to_vec())?;
            }
        }
        if let Some(channel) = self.channels.imu {
            for reading in &frame.gyroscope {
                self.put(channel, reading.timestamp, &imu(reading))?;
            }
        }
        let depth = depth_image(&frame.depth, &self.info.calibration, time);
        self.put(self.channels.depth, time, &depth.encode_to_vec())?;
        if let (Some(channel), Some(colour)) = (self.channels.colour, &frame.colour) {
            let colour_time = frame.colour_timestamp.unwrap_or(time);
            self.tolerance_ns = self.tolerance_ns.max(colour_time.0.saturating_sub(time.0).saturating_abs());
            let image = colour_image(colour, colour_time).map_err(|reason| Error::io("write", &self.path, reason))?;
            self.put(channel, colour_time, &image.encode_to_vec())?;
        }
        Ok(())
    }

    /// Writes what is left, brings the file to the disk and gives it its name.
    ///
    /// # Errors
    /// Where the file cannot be written; there is no file of its name then, or the one that was.
    pub fn finish(mut self) -> Result<(), Error> {
        self.write_truth_until(None)?;
        let time = if self.info.has_timestamps { "stamps" } else { NOMINAL_TIME };
        let metadata = [
            ("recording", self.info.name.clone()),
            ("format", self.info.format.to_string()),
            ("calibration", self.info.calibration_source.clone()),
            (TIME_KEY, time.into()),
            (TOLERANCE_KEY, self.tolerance_ns.to_string()),
        ];
        let metadata = ::mcap::records::Metadata {
            name: METADATA.into(),
            metadata: metadata.into_iter().map(|(key, value)| (key.to_string(), value)).collect(),
        };
        let failed = |reason| Error::io("write", &self.path, reason);
        self.writer.write_metadata(&metadata).map_err(as_io).map_err(failed)?;
        self.writer.finish().map_err(as_io).map_err(failed)?;
        self.writer.into_inner().finish().map_err(failed)
    }

    fn put(&mut self, channel_id: u16, time: Timestamp, data: &[u8]) -> Result<(), Error> {
        let sequence = self.sequences.entry(channel_id).or_default();
        // Logs begin in 1970; the message itself has its time whatever it is.
        let log_time = u64::try_from(time.0).unwrap_or(0);
        let header = MessageHeader { channel_id, sequence: *sequence, log_time, publish_time: log_time };
        *sequence += 1;
        let written = self.writer.write_to_known_channel(&header, data);
        written.map_err(|reason| Error::io("write", &self.path, as_io(reason)))
    }

    fn write_cameras(&mut self, time: Timestamp) -> Result<(), Error> {
        let Calibration { depth, colour, colour_from_depth, depth_distortion, colour_distortion, .. } =
            self.info.calibration;
        let calibration = camera(&depth, &depth_distortion, DEPTH_CAMERA, time);
        self.put(self.channels.depth_info, time, &calibration.encode_to_vec())?;
        if let Some(channel) = self.channels.colour_info {
            let calibration = camera(&colour, &colour_distortion, COLOUR_CAMERA, time);
            self.put(channel, time, &calibration.encode_to_vec())?;
        }
        match self.channels.transforms {
            Some(channel) if self.channels.colour.is_some() => {
                let transform = FrameTransform::new(time, COLOUR_CAMERA, DEPTH_CAMERA, &colour_from_depth);
                self.put(channel, time, &transform.encode_to_vec())
            }
            _ => Ok(()),
        }
    }

    /// Writes the true poses up to a moment, or all that are left.
    fn write_truth_until(&mut self, time: Option<Timestamp>) -> Result<(), Error> {
        let (Some(channel), Some(truth)) = (self.channels.truth, &self.info.ground_truth) else { return Ok(()) };
        let end = time.map_or(truth.len(), |time| truth.poses().partition_point(|pose| pose.timestamp <= time));
        let poses: Vec<StampedPose> = truth.poses().get(self.poses_written..end).unwrap_or_default().to_vec();
        self.poses_written = end.max(self.poses_written);
        for StampedPose { timestamp, world_from_camera } in poses {
            let pose = PoseInFrame::new(timestamp, WORLD, &world_from_camera);
            self.put(channel, timestamp, &pose.encode_to_vec())?;
        }
        Ok(())
    }
}

impl Channels {
    fn add(writer: &mut Writer<WholeFile>, info: &RecordingInfo) -> Result<Self, McapError> {
        let none = BTreeMap::new();
        let mut add = |topic: &str, schema: &str| -> Result<u16, McapError> {
            let data = foxglove::schema(schema);
            let schema = writer.add_schema(&format!("foxglove.{schema}"), "protobuf", &data)?;
            writer.add_channel(schema, topic, "protobuf", &none)
        };
        let depth = add("/depth/image", "RawImage")?;
        let depth_info = add("/depth/calibration", "CameraCalibration")?;
        let mut colour = None;
        let mut colour_info = None;
        if info.has_colour {
            colour = Some(add("/color/image", "CompressedImage")?);
            colour_info = Some(add("/color/calibration", "CameraCalibration")?);
        }
        let truth = Some(add("/ground_truth", "PoseInFrame")?);
        let transforms = Some(add("/tf", "FrameTransform")?);
        let mut imu = None;
        if info.has_gyroscope {
            let schema = writer.add_schema("sensor_msgs/msg/Imu", "ros2msg", IMU_SCHEMA.as_bytes())?;
            imu = Some(writer.add_channel(schema, "/imu", "cdr", &none)?);
        }
        Ok(Self { depth, colour, depth_info, colour_info, truth, transforms, imu })
    }
}

fn camera(camera: &Intrinsics, lens: &Distortion, frame: &str, time: Timestamp) -> CameraCalibration {
    let &Intrinsics { width, height, fx, fy, cx, cy } = camera;
    let (model, coefficients) = match lens {
        Distortion::None | Distortion::Brown { .. } => ("plumb_bob", 5),
        Distortion::Rational { .. } => ("rational_polynomial", 8),
    };
    CameraCalibration {
        timestamp: Some(time.into()),
        width,
        height,
        distortion_model: model.into(),
        d: lens.coefficients()[..coefficients].to_vec(),
        k: vec![fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        frame_id: frame.into(),
    }
}

fn depth_image(depth: &DepthImage, calibration: &Calibration, time: Timestamp) -> RawImage {
    let (width, height) = depth.size();
    let (encoding, bytes, data): (_, u32, Vec<u8>) = match depth {
        DepthImage::Raw(image) if calibration.depth_conversion == DepthConversion::MILLIMETRES => {
            ("16UC1", 2, image.data().iter().flat_map(|value| value.to_le_bytes()).collect())
        }
        DepthImage::Raw(image) => {
            let metres = |&value: &u16| calibration.metres(value).to_le_bytes();
            ("32FC1", 4, image.data().iter().flat_map(metres).collect())
        }
        DepthImage::Metres(image) => ("32FC1", 4, image.data().iter().flat_map(|value| value.to_le_bytes()).collect()),
    };
    RawImage {
        timestamp: Some(time.into()),
        width,
        height,
        encoding: encoding.into(),
        step: width * bytes,
        data,
        frame_id: DEPTH_CAMERA.into(),
    }
}

fn colour_image(colour: &ColourImage, time: Timestamp) -> io::Result<CompressedImage> {
    let rgb: Vec<u8> = colour.data().iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    let mut data = Vec::new();
    PngEncoder::new(&mut data)
        .write_image(&rgb, colour.width(), colour.height(), ExtendedColorType::Rgb8)
        .map_err(io::Error::other)?;
    Ok(CompressedImage::new(time, data, "png", COLOUR_CAMERA))
}

/// A reading as `sensor_msgs/Imu` in little-endian CDR, with nothing known of orientation and acceleration.
fn imu(reading: &AngularRate) -> Vec<u8> {
    // A first covariance of -1 says that a sensor has no such part.
    const NO_COVARIANCE: [f64; 9] = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let seconds = reading.timestamp.0.div_euclid(1_000_000_000);
    let seconds = i32::try_from(seconds).unwrap_or(if seconds < 0 { i32::MIN } else { i32::MAX });
    let nanoseconds = u32::try_from(reading.timestamp.0.rem_euclid(1_000_000_000)).expect("less than a second");
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend(seconds.to_le_bytes());
    bytes.extend(nanoseconds.to_le_bytes());
    bytes.extend(4_u32.to_le_bytes());
    bytes.extend(b"imu\0");
    let numbers = Se3::IDENTITY.rotation.to_array().into_iter().chain(NO_COVARIANCE);
    let numbers = numbers.chain(reading.rad_per_s.to_array()).chain([0.0; 9]);
    // The header takes 16 bytes, so that numbers are aligned.
    bytes.extend(numbers.chain([0.0; 3]).chain(NO_COVARIANCE).flat_map(f64::to_le_bytes));
    bytes
}
