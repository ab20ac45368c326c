//! What messages say, whichever encoding they came in.

use std::borrow::Cow;

use glam::{DQuat, DVec3};
use itm_core::{Distortion, Intrinsics, Se3, Timestamp};

use super::{cdr, foxglove};

/// A kind of message that is read here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    RosImage,
    RosCompressedImage,
    RosCameraInfo,
    RosTransforms,
    RosTransform,
    RosPose,
    RosOdometry,
    RosInertial,
    FoxgloveRawImage,
    FoxgloveCompressedImage,
    FoxgloveCameraCalibration,
    FoxglovePose,
    FoxgloveOdometry,
    FoxgloveTransform,
    FoxgloveTransforms,
}

/// What messages of a kind are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    Image,
    Camera,
    /// Poses of one thing.
    Pose,
    /// A tree of frames.
    Transforms,
    Inertial,
}

impl Kind {
    /// Of a channel's message encoding (`cdr`, `protobuf`) and its schema's name.
    pub(super) fn of(encoding: &str, schema: &str) -> Option<Self> {
        Some(match (encoding, schema) {
            ("cdr", "sensor_msgs/msg/Image") => Self::RosImage,
            ("cdr", "sensor_msgs/msg/CompressedImage") => Self::RosCompressedImage,
            ("cdr", "sensor_msgs/msg/CameraInfo") => Self::RosCameraInfo,
            ("cdr", "sensor_msgs/msg/Imu") => Self::RosInertial,
            ("cdr", "tf2_msgs/msg/TFMessage") => Self::RosTransforms,
            ("cdr", "geometry_msgs/msg/TransformStamped") => Self::RosTransform,
            ("cdr", "geometry_msgs/msg/PoseStamped" | "geometry_msgs/msg/PoseWithCovarianceStamped") => Self::RosPose,
            ("cdr", "nav_msgs/msg/Odometry") => Self::RosOdometry,
            ("protobuf", "foxglove.RawImage") => Self::FoxgloveRawImage,
            ("protobuf", "foxglove.CompressedImage") => Self::FoxgloveCompressedImage,
            ("protobuf", "foxglove.CameraCalibration") => Self::FoxgloveCameraCalibration,
            ("protobuf", "foxglove.PoseInFrame") => Self::FoxglovePose,
            ("protobuf", "foxglove.Odometry") => Self::FoxgloveOdometry,
            ("protobuf", "foxglove.FrameTransform") => Self::FoxgloveTransform,
            ("protobuf", "foxglove.FrameTransforms") => Self::FoxgloveTransforms,
            _ => return None,
        })
    }

    pub(super) fn purpose(self) -> Purpose {
        match self {
            Self::RosImage | Self::RosCompressedImage | Self::FoxgloveRawImage | Self::FoxgloveCompressedImage => {
                Purpose::Image
            }
            Self::RosCameraInfo | Self::FoxgloveCameraCalibration => Purpose::Camera,
            Self::RosTransform | Self::RosPose | Self::RosOdometry | Self::FoxglovePose | Self::FoxgloveOdometry => {
                Purpose::Pose
            }
            Self::RosTransforms | Self::FoxgloveTransform | Self::FoxgloveTransforms => Purpose::Transforms,
            Self::RosInertial => Purpose::Inertial,
        }
    }

    /// Whether images come as an image file's bytes.
    pub(super) fn is_compressed(self) -> bool {
        matches!(self, Self::RosCompressedImage | Self::FoxgloveCompressedImage)
    }

    /// When an image was taken, from the beginning of its message; `None` where that does not tell, as of a protobuf message
    /// whose fields are not in their order.
    pub(super) fn image_stamp(self, start: &[u8]) -> Result<Option<Timestamp>, String> {
        match self {
            Self::FoxgloveRawImage | Self::FoxgloveCompressedImage => Ok(foxglove::stamp_at_start(start)),
            _ => cdr::stamp(start).map(Some),
        }
    }

    /// When an image was taken, from the whole message.
    pub(super) fn stamp_of_image(self, message: &[u8]) -> Result<Timestamp, String> {
        match self {
            Self::FoxgloveRawImage | Self::FoxgloveCompressedImage => foxglove::stamp(message),
            _ => cdr::stamp(message),
        }
    }

    pub(super) fn image(self, message: &[u8]) -> Result<ImageMessage<'_>, String> {
        match self {
            Self::RosImage => cdr::image(message),
            Self::RosCompressedImage => cdr::compressed_image(message),
            Self::FoxgloveRawImage => foxglove::raw_image(message),
            Self::FoxgloveCompressedImage => foxglove::compressed_image(message),
            _ => Err("not an image".into()),
        }
    }

    pub(super) fn camera(self, message: &[u8]) -> Result<CameraInfo, String> {
        match self {
            Self::RosCameraInfo => cdr::camera_info(message),
            Self::FoxgloveCameraCalibration => foxglove::camera_calibration(message),
            _ => Err("not a camera's calibration".into()),
        }
    }

    pub(super) fn transforms(self, message: &[u8]) -> Result<Vec<StampedTransform>, String> {
        match self {
            Self::RosTransforms => cdr::transforms(message),
            Self::RosTransform => cdr::transform(message).map(|one| vec![one]),
            Self::RosPose => cdr::pose(message).map(|one| vec![one]),
            Self::RosOdometry => cdr::odometry(message).map(|one| vec![one]),
            Self::FoxglovePose => foxglove::pose(message).map(|one| vec![one]),
            Self::FoxgloveOdometry => foxglove::odometry(message).map(|one| vec![one]),
            Self::FoxgloveTransform => foxglove::transform(message).map(|one| vec![one]),
            Self::FoxgloveTransforms => foxglove::transforms(message),
            _ => Err("not a pose".into()),
        }
    }
}

/// A moment from seconds and nanoseconds, saturating.
pub(super) fn timestamp(seconds: i64, nanoseconds: i64) -> Timestamp {
    Timestamp(seconds.saturating_mul(1_000_000_000).saturating_add(nanoseconds))
}

/// A motion from a message's numbers. A quaternion that has unit length to rounding keeps its bits.
pub(super) fn rigid(rotation: DQuat, translation: DVec3) -> Result<Se3, String> {
    let checked = Se3::try_from_quaternion(rotation, translation).map_err(|error| error.to_string())?;
    let is_unit = (rotation.length_squared() - 1.0).abs() < 1e-14;
    Ok(if is_unit { Se3 { rotation, translation } } else { checked })
}

/// An image as it came.
#[derive(Debug)]
pub(super) struct ImageMessage<'a> {
    /// Name of the camera's frame.
    pub(super) frame: String,
    pub(super) pixels: Pixels<'a>,
}

#[derive(Debug)]
pub(super) enum Pixels<'a> {
    Raw {
        width: u32,
        height: u32,
        /// As ROS names them: `16UC1`, `rgb8` …
        encoding: String,
        big_endian: bool,
        /// Bytes of a row.
        step: usize,
        data: Cow<'a, [u8]>,
    },
    Compressed {
        /// `png`, `jpeg`, `16UC1; compressedDepth png`.
        format: String,
        data: Cow<'a, [u8]>,
    },
}

/// A motion between two frames at a moment.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StampedTransform {
    pub(super) stamp: Timestamp,
    pub(super) parent: String,
    /// `None` where the message does not name what it is the pose of.
    pub(super) child: Option<String>,
    pub(super) parent_from_child: Se3,
}

/// A gyroscope's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Inertial {
    pub(super) stamp: Timestamp,
    pub(super) rad_per_s: DVec3,
}

/// A part of a sensor's image, in its pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Region {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

/// A camera as its messages describe it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CameraInfo {
    pub(super) frame: String,
    /// Of the sensor's whole image.
    pub(super) width: u32,
    pub(super) height: u32,
    /// Name of the model of the lens.
    pub(super) model: String,
    pub(super) lens: Vec<f64>,
    /// Of the images as the lens shows them, by rows.
    pub(super) k: [f64; 9],
    /// Of rectified images, by rows.
    pub(super) p: [f64; 12],
    pub(super) binning: (u32, u32),
    pub(super) region: Region,
}

impl CameraInfo {
    /// The camera of images of a size: as the lens shows them, or rectified.
    pub(super) fn camera(&self, size: (u32, u32), rectified: bool) -> Result<(Intrinsics, Distortion), String> {
        let [fx, _, cx, _, fy, cy, ..] = self.k;
        let [pfx, _, pcx, _, _, pfy, pcy, ..] = self.p;
        let use_p = rectified && pfx != 0.0 && pfy != 0.0;
        let [fx, fy, cx, cy] = if use_p { [pfx, pfy, pcx, pcy] } else { [fx, fy, cx, cy] };
        let lens = if rectified { Distortion::None } else { self.distortion()? };
        // The message describes the whole sensor; images may be a part of it, and of every so many pixels.
        let (bin_x, bin_y) = (self.binning.0.max(1), self.binning.1.max(1));
        let is_part = self.region.width > 0 && self.region.height > 0;
        let (width, height) = if is_part { (self.region.width, self.region.height) } else { (self.width, self.height) };
        let (bx, by) = (f64::from(bin_x), f64::from(bin_y));
        let (x, y) = if is_part { (f64::from(self.region.x), f64::from(self.region.y)) } else { (0.0, 0.0) };
        let camera = Intrinsics::new(width / bin_x, height / bin_y, fx / bx, fy / by, (cx - x) / bx, (cy - y) / by);
        if (camera.width, camera.height) != size {
            return Err(format!(
                "it describes images of {}x{} pixels, but they have {}x{}",
                camera.width, camera.height, size.0, size.1
            ));
        }
        Ok((camera, lens))
    }

    fn distortion(&self) -> Result<Distortion, String> {
        let zero = self.lens.iter().all(|&coefficient| coefficient == 0.0);
        let lens = match (self.model.as_str(), self.lens.as_slice()) {
            // Without coefficients these are a pinhole camera; a fisheye is none.
            (
                "" | "none" | "None" | "plumb_bob" | "rational_polynomial" | "brown_conrady" | "inverse_brown_conrady",
                _,
            ) if zero => Distortion::None,
            ("Inverse Brown Conrady" | "Brown Conrady" | "Modified Brown Conrady", _) if zero => Distortion::None,
            ("plumb_bob", &[k1, k2, p1, p2]) => Distortion::brown([k1, k2, p1, p2, 0.0]),
            ("plumb_bob" | "rational_polynomial", &[k1, k2, p1, p2, k3]) => Distortion::brown([k1, k2, p1, p2, k3]),
            ("rational_polynomial", &[k1, k2, p1, p2, k3, k4, k5, k6, ref thin @ ..])
                if thin.iter().all(|&coefficient| coefficient == 0.0) =>
            {
                Distortion::rational([k1, k2, p1, p2, k3, k4, k5, k6])
            }
            (model, lens) => {
                return Err(format!(
                    "the lens model '{model}' with {} coefficients cannot be represented: expected plumb_bob with 4 or 5, \
                     rational_polynomial with 8, or none",
                    lens.len()
                ));
            }
        };
        Ok(lens)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KINDS: [Kind; 15] = [
        Kind::RosImage,
        Kind::RosCompressedImage,
        Kind::RosCameraInfo,
        Kind::RosTransforms,
        Kind::RosTransform,
        Kind::RosPose,
        Kind::RosOdometry,
        Kind::RosInertial,
        Kind::FoxgloveRawImage,
        Kind::FoxgloveCompressedImage,
        Kind::FoxgloveCameraCalibration,
        Kind::FoxglovePose,
        Kind::FoxgloveOdometry,
        Kind::FoxgloveTransform,
        Kind::FoxgloveTransforms,
    ];

    /// Reads a message in every way; what comes of it does not matter.
    fn read_all(message: &[u8]) {
        for kind in KINDS {
            let _stamp = kind.image_stamp(message);
            let _stamp = kind.stamp_of_image(message);
            if let Ok(image) = kind.image(message) {
                let _sample = crate::recording::mcap::pixels::Sample::of(&image);
                let _depth = crate::recording::mcap::pixels::depth(&image, (3, 2));
                let _colour = crate::recording::mcap::pixels::colour(&image, (3, 2));
            }
            if let Ok(camera) = kind.camera(message) {
                let _camera = camera.camera((3, 2), false);
            }
            let _transforms = kind.transforms(message);
            let _reading = cdr::inertial(message);
        }
    }

    proptest! {
        #[test]
        fn no_bytes_are_too_bad_to_be_read(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            read_all(&bytes);
        }

        #[test]
        fn no_message_of_cdr_is_too_bad_to_be_read(
            kind in prop::sample::select(vec![0_u8, 1, 6, 7]),
            bytes in prop::collection::vec(prop_oneof![4 => Just(0_u8), 2 => 0..9_u8, 1 => any::<u8>()], 0..600),
        ) {
            read_all(&[&[0, kind, 0, 0], bytes.as_slice()].concat());
        }

        #[test]
        fn stamps_of_foxglove_come_back(ns in any::<i64>()) {
            let pose = foxglove::PoseInFrame::new(Timestamp(ns), "world", &Se3::IDENTITY);
            let message = prost::Message::encode_to_vec(&pose);
            prop_assert_eq!(foxglove::stamp_at_start(&message), Some(Timestamp(ns)));
            prop_assert_eq!(foxglove::pose(&message).map(|pose| pose.stamp), Ok(Timestamp(ns)));
        }
    }

    #[test]
    fn a_unit_quaternion_keeps_its_bits_and_others_become_one() {
        let unit = DQuat::from_xyzw(0.1, 0.2, 0.3, 0.9).normalize();
        assert_eq!(rigid(unit, DVec3::X).map(|pose| pose.rotation), Ok(unit));
        let near = rigid(unit * 1.001, DVec3::X).unwrap();
        assert!((near.rotation.length() - 1.0).abs() < 1e-15);
        assert!(rigid(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), DVec3::X).is_err());
        assert!(rigid(unit, DVec3::NAN).is_err());
    }

    #[test]
    fn rectified_images_have_the_projection_of_their_own() {
        let mut p = [0.0; 12];
        [p[0], p[2], p[5], p[6]] = [40.0, 8.0, 41.0, 6.0];
        let info = CameraInfo {
            frame: "camera".into(),
            width: 16,
            height: 12,
            model: "plumb_bob".into(),
            lens: vec![0.1; 5],
            k: [20.0, 0.0, 7.5, 0.0, 21.0, 5.5, 0.0, 0.0, 1.0],
            p,
            binning: (0, 0),
            region: Region::default(),
        };
        assert_eq!(info.camera((16, 12), true), Ok((Intrinsics::new(16, 12, 40.0, 41.0, 8.0, 6.0), Distortion::None)));
        let (camera, lens) = info.camera((16, 12), false).unwrap();
        assert_eq!((camera.fx, lens), (20.0, Distortion::brown([0.1; 5])));
    }
}
