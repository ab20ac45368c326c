//! ROS 2's messages in CDR, the encoding that DDS sends (OMG, *DDS Interoperability Wire Protocol* 2.5 and *Extensible and
//! Dynamic Topic Types for DDS* 1.3: plain CDR of XCDR1 and XCDR2, both byte orders).
//!
//! Layouts are those of ROS 2's `.msg` files; of each message only the fields up to the last one that is needed are read, so
//! that fields that later versions add behind them do no harm.

use std::borrow::Cow;

use glam::{DQuat, DVec3};
use itm_core::Timestamp;

use super::messages::{CameraInfo, ImageMessage, Inertial, Pixels, Region, StampedTransform, rigid, timestamp};

/// A reader over a message's bytes that never reads beyond them.
struct Reader<'a> {
    /// Behind the header, from where values are aligned.
    body: &'a [u8],
    at: usize,
    big_endian: bool,
    /// Values of 8 bytes are aligned to 8 in XCDR1 and to 4 in XCDR2.
    max_align: usize,
}

const CUT_OFF: &str = "the message is cut off";

macro_rules! number {
    ($name:ident, $type:ty) => {
        fn $name(&mut self) -> Result<$type, String> {
            const SIZE: usize = size_of::<$type>();
            self.align(SIZE);
            let bytes = self.take(SIZE)?.first_chunk::<SIZE>().ok_or(CUT_OFF)?;
            Ok(if self.big_endian { <$type>::from_be_bytes(*bytes) } else { <$type>::from_le_bytes(*bytes) })
        }
    };
}

impl<'a> Reader<'a> {
    fn new(message: &'a [u8]) -> Result<Self, String> {
        let (&[zero, kind, _, _], body) = message.split_first_chunk().ok_or(CUT_OFF)?;
        let max_align = match (zero, kind) {
            (0, 0 | 1) => 8,
            (0, 6 | 7) => 4,
            _ => return Err(format!("expected plain CDR (encapsulation 0, 1, 6 or 7), found {zero:02x}{kind:02x}")),
        };
        Ok(Self { body, at: 0, big_endian: kind % 2 == 0, max_align })
    }

    fn align(&mut self, size: usize) {
        self.at = self.at.next_multiple_of(size.min(self.max_align));
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        let bytes = self.body.get(self.at..).and_then(|rest| rest.get(..length)).ok_or(CUT_OFF)?;
        self.at += length;
        Ok(bytes)
    }

    number!(u8, u8);
    number!(u32, u32);
    number!(i32, i32);
    number!(f64, f64);

    fn bytes(&mut self) -> Result<&'a [u8], String> {
        let length = self.u32()? as usize;
        self.take(length)
    }

    fn string(&mut self) -> Result<String, String> {
        let bytes = self.bytes()?;
        // The terminating zero counts; some writers leave it out of empty strings.
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        String::from_utf8(text.to_vec()).map_err(|_| "a text in the message is not UTF-8".into())
    }

    fn f64s(&mut self) -> Result<Vec<f64>, String> {
        let count = self.u32()? as usize;
        // Checked before anything is allocated for it.
        if count > self.body.len() / size_of::<f64>() {
            return Err(CUT_OFF.into());
        }
        (0..count).map(|_| self.f64()).collect()
    }

    fn array<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// `std_msgs/Header`: the stamp and the frame's name.
    fn header(&mut self) -> Result<(Timestamp, String), String> {
        let stamp = timestamp(self.i32()?.into(), self.u32()?.into());
        Ok((stamp, self.string()?))
    }

    fn vector(&mut self) -> Result<DVec3, String> {
        Ok(DVec3::from_array(self.array()?))
    }

    fn quaternion(&mut self) -> Result<DQuat, String> {
        Ok(DQuat::from_array(self.array()?))
    }

    /// `geometry_msgs/TransformStamped`.
    fn transform(&mut self) -> Result<StampedTransform, String> {
        let (stamp, parent) = self.header()?;
        let child = self.string()?;
        let (translation, rotation) = (self.vector()?, self.quaternion()?);
        Ok(StampedTransform { stamp, parent, child: Some(child), parent_from_child: rigid(rotation, translation)? })
    }
}

/// The stamp that begins a message with a header, from its first bytes.
pub(super) fn stamp(start: &[u8]) -> Result<Timestamp, String> {
    let mut reader = Reader::new(start)?;
    Ok(timestamp(reader.i32()?.into(), reader.u32()?.into()))
}

/// `sensor_msgs/Image`.
pub(super) fn image(message: &[u8]) -> Result<ImageMessage<'_>, String> {
    let mut reader = Reader::new(message)?;
    let (_, frame) = reader.header()?;
    let (height, width) = (reader.u32()?, reader.u32()?);
    let encoding = reader.string()?;
    let big_endian = reader.u8()? != 0;
    let step = reader.u32()? as usize;
    let data = Cow::Borrowed(reader.bytes()?);
    Ok(ImageMessage { frame, pixels: Pixels::Raw { width, height, encoding, big_endian, step, data } })
}

/// `sensor_msgs/CompressedImage`.
pub(super) fn compressed_image(message: &[u8]) -> Result<ImageMessage<'_>, String> {
    let mut reader = Reader::new(message)?;
    let (_, frame) = reader.header()?;
    let format = reader.string()?;
    Ok(ImageMessage { frame, pixels: Pixels::Compressed { format, data: Cow::Borrowed(reader.bytes()?) } })
}

/// `sensor_msgs/CameraInfo`.
pub(super) fn camera_info(message: &[u8]) -> Result<CameraInfo, String> {
    let mut reader = Reader::new(message)?;
    let (_, frame) = reader.header()?;
    let (height, width) = (reader.u32()?, reader.u32()?);
    let model = reader.string()?;
    let lens = reader.f64s()?;
    let k = reader.array()?;
    let _rectification: [f64; 9] = reader.array()?;
    let p = reader.array()?;
    let binning = (reader.u32()?, reader.u32()?);
    let (x, y) = (reader.u32()?, reader.u32()?);
    let (height_of_region, width_of_region) = (reader.u32()?, reader.u32()?);
    let region = Region { x, y, width: width_of_region, height: height_of_region };
    Ok(CameraInfo { frame, width, height, model, lens, k, p, binning, region })
}

/// `tf2_msgs/TFMessage`.
pub(super) fn transforms(message: &[u8]) -> Result<Vec<StampedTransform>, String> {
    let mut reader = Reader::new(message)?;
    let count = reader.u32()?;
    // Each takes bytes, so that a count that lies ends at the message's end.
    (0..count).map(|_| reader.transform()).collect()
}

/// `geometry_msgs/TransformStamped`.
pub(super) fn transform(message: &[u8]) -> Result<StampedTransform, String> {
    Reader::new(message)?.transform()
}

/// `geometry_msgs/PoseStamped`, or `PoseWithCovarianceStamped`, which begins as it does.
pub(super) fn pose(message: &[u8]) -> Result<StampedTransform, String> {
    let mut reader = Reader::new(message)?;
    let (stamp, parent) = reader.header()?;
    let (translation, rotation) = (reader.vector()?, reader.quaternion()?);
    Ok(StampedTransform { stamp, parent, child: None, parent_from_child: rigid(rotation, translation)? })
}

/// `nav_msgs/Odometry`, whose pose begins as a transform does.
pub(super) fn odometry(message: &[u8]) -> Result<StampedTransform, String> {
    transform(message)
}

/// `sensor_msgs/Imu`.
pub(super) fn inertial(message: &[u8]) -> Result<Inertial, String> {
    let mut reader = Reader::new(message)?;
    let (stamp, _) = reader.header()?;
    let _orientation_and_covariance: [f64; 4 + 9] = reader.array()?;
    Ok(Inertial { stamp, rad_per_s: reader.vector()? })
}
