//! Foxglove's schemas in protobuf, with the numbers of their `.proto` files (<https://docs.foxglove.dev/docs/sdk/schemas>).

use std::borrow::Cow;

use glam::{DQuat, DVec3};
use itm_core::{Se3, Timestamp};
use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

use super::messages::{CameraInfo, ImageMessage, Pixels, Region, StampedTransform, rigid, timestamp};

/// `google.protobuf.Timestamp`.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct Time {
    #[prost(int64, tag = "1")]
    seconds: i64,
    #[prost(int32, tag = "2")]
    nanos: i32,
}

impl From<Timestamp> for Time {
    fn from(time: Timestamp) -> Self {
        let nanos = i32::try_from(time.0.rem_euclid(1_000_000_000)).expect("less than a second's nanoseconds");
        Self { seconds: time.0.div_euclid(1_000_000_000), nanos }
    }
}

fn stamp_from(time: Option<Time>) -> Timestamp {
    let time = time.unwrap_or_default();
    timestamp(time.seconds, time.nanos.into())
}

/// The field that all messages with a stamp share.
#[derive(Clone, PartialEq, Message)]
struct Stamped {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Time>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct RawImage {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Time>,
    #[prost(fixed32, tag = "2")]
    pub(super) width: u32,
    #[prost(fixed32, tag = "3")]
    pub(super) height: u32,
    #[prost(string, tag = "4")]
    pub(super) encoding: String,
    #[prost(fixed32, tag = "5")]
    pub(super) step: u32,
    #[prost(bytes = "vec", tag = "6")]
    pub(super) data: Vec<u8>,
    #[prost(string, tag = "7")]
    pub(super) frame_id: String,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Time>,
    #[prost(bytes = "vec", tag = "2")]
    data: Vec<u8>,
    #[prost(string, tag = "3")]
    format: String,
    #[prost(string, tag = "4")]
    frame_id: String,
}

impl CompressedImage {
    pub(super) fn new(stamp: Timestamp, data: Vec<u8>, format: &str, frame: &str) -> Self {
        Self { timestamp: Some(stamp.into()), data, format: format.into(), frame_id: frame.into() }
    }
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct CameraCalibration {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Time>,
    #[prost(fixed32, tag = "2")]
    pub(super) width: u32,
    #[prost(fixed32, tag = "3")]
    pub(super) height: u32,
    #[prost(string, tag = "4")]
    pub(super) distortion_model: String,
    #[prost(double, repeated, tag = "5")]
    pub(super) d: Vec<f64>,
    #[prost(double, repeated, tag = "6")]
    pub(super) k: Vec<f64>,
    #[prost(double, repeated, tag = "7")]
    pub(super) r: Vec<f64>,
    #[prost(double, repeated, tag = "8")]
    pub(super) p: Vec<f64>,
    #[prost(string, tag = "9")]
    pub(super) frame_id: String,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Vector3 {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

impl From<DVec3> for Vector3 {
    fn from(v: DVec3) -> Self {
        Self { x: v.x, y: v.y, z: v.z }
    }
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Quaternion {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

impl From<DQuat> for Quaternion {
    fn from(q: DQuat) -> Self {
        Self { x: q.x, y: q.y, z: q.z, w: q.w }
    }
}

fn motion(translation: Option<Vector3>, rotation: Option<Quaternion>) -> Result<Se3, String> {
    let t = translation.unwrap_or_default();
    // Protobuf leaves out what is zero: no rotation at all is one that nobody set.
    let q = rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_xyzw(q.x, q.y, q.z, q.w));
    rigid(q, DVec3::new(t.x, t.y, t.z))
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Pose {
    #[prost(message, optional, tag = "1")]
    position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<Quaternion>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Time>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
}

impl PoseInFrame {
    pub(super) fn new(stamp: Timestamp, frame: &str, pose: &Se3) -> Self {
        let pose = Pose { position: Some(pose.translation.into()), orientation: Some(pose.rotation.into()) };
        Self { timestamp: Some(stamp.into()), frame_id: frame.into(), pose: Some(pose) }
    }
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Time>,
    #[prost(string, tag = "2")]
    parent_frame_id: String,
    #[prost(string, tag = "3")]
    child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    rotation: Option<Quaternion>,
}

impl FrameTransform {
    pub(super) fn new(stamp: Timestamp, parent: &str, child: &str, parent_from_child: &Se3) -> Self {
        Self {
            timestamp: Some(stamp.into()),
            parent_frame_id: parent.into(),
            child_frame_id: child.into(),
            translation: Some(parent_from_child.translation.into()),
            rotation: Some(parent_from_child.rotation.into()),
        }
    }

    fn read(self) -> Result<StampedTransform, String> {
        Ok(StampedTransform {
            stamp: stamp_from(self.timestamp),
            parent: self.parent_frame_id,
            child: Some(self.child_frame_id),
            parent_from_child: motion(self.translation, self.rotation)?,
        })
    }
}

#[derive(Clone, PartialEq, Message)]
struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    transforms: Vec<FrameTransform>,
}

#[derive(Clone, PartialEq, Message)]
struct Odometry {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Time>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(string, tag = "3")]
    body_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pose: Option<Pose>,
}

fn decode<M: Message + Default>(message: &[u8]) -> Result<M, String> {
    M::decode(message).map_err(|error| error.to_string())
}

/// The stamp, where it is the first field and lies in these first bytes whole.
pub(super) fn stamp_at_start(start: &[u8]) -> Option<Timestamp> {
    // Field 1 with a length; a stamp is shorter than 128 bytes, so that its length takes one.
    let (&[0x0a, length], rest) = start.split_first_chunk()? else { return None };
    let time = rest.get(..usize::from(length))?;
    (length < 0x80).then(|| Time::decode(time).ok()).flatten().map(|time| stamp_from(Some(time)))
}

pub(super) fn stamp(message: &[u8]) -> Result<Timestamp, String> {
    Ok(stamp_from(decode::<Stamped>(message)?.timestamp))
}

pub(super) fn raw_image(message: &[u8]) -> Result<ImageMessage<'static>, String> {
    let RawImage { width, height, encoding, step, data, frame_id: frame, .. } = decode(message)?;
    // The schema has no byte order but the little-endian one.
    let (step, data) = (step as usize, Cow::Owned(data));
    Ok(ImageMessage { frame, pixels: Pixels::Raw { width, height, encoding, big_endian: false, step, data } })
}

pub(super) fn compressed_image(message: &[u8]) -> Result<ImageMessage<'static>, String> {
    let CompressedImage { data, format, frame_id: frame, .. } = decode(message)?;
    Ok(ImageMessage { frame, pixels: Pixels::Compressed { format, data: Cow::Owned(data) } })
}

pub(super) fn camera_calibration(message: &[u8]) -> Result<CameraInfo, String> {
    let CameraCalibration { width, height, distortion_model: model, d: lens, k, p, frame_id: frame, .. } =
        decode(message)?;
    let k = k.try_into().map_err(|k: Vec<f64>| format!("expected a K of 9 numbers, found {}", k.len()))?;
    // An image that is not rectified needs no P.
    let p = if p.is_empty() { vec![0.0; 12] } else { p };
    let p = p.try_into().map_err(|p: Vec<f64>| format!("expected a P of 12 numbers, found {}", p.len()))?;
    Ok(CameraInfo { frame, width, height, model, lens, k, p, binning: (1, 1), region: Region::default() })
}

pub(super) fn pose(message: &[u8]) -> Result<StampedTransform, String> {
    let PoseInFrame { timestamp, frame_id: parent, pose } = decode(message)?;
    let Pose { position, orientation } = pose.unwrap_or_default();
    let parent_from_child = motion(position, orientation)?;
    Ok(StampedTransform { stamp: stamp_from(timestamp), parent, child: None, parent_from_child })
}

pub(super) fn odometry(message: &[u8]) -> Result<StampedTransform, String> {
    let Odometry { timestamp, frame_id: parent, body_frame_id, pose } = decode(message)?;
    let Pose { position, orientation } = pose.unwrap_or_default();
    let parent_from_child = motion(position, orientation)?;
    Ok(StampedTransform { stamp: stamp_from(timestamp), parent, child: Some(body_frame_id), parent_from_child })
}

pub(super) fn transform(message: &[u8]) -> Result<StampedTransform, String> {
    decode::<FrameTransform>(message)?.read()
}

pub(super) fn transforms(message: &[u8]) -> Result<Vec<StampedTransform>, String> {
    decode::<FrameTransforms>(message)?.transforms.into_iter().map(FrameTransform::read).collect()
}

/// A field of a schema: its name, its number and its type; of another message where that is named.
type Field = (&'static str, i32, Type, Label, Option<&'static str>);

const fn field(name: &'static str, number: i32, kind: Type) -> Field {
    (name, number, kind, Label::Optional, None)
}

const fn message(name: &'static str, number: i32, of: &'static str) -> Field {
    (name, number, Type::Message, Label::Optional, Some(of))
}

const fn doubles(name: &'static str, number: i32) -> Field {
    (name, number, Type::Double, Label::Repeated, None)
}

const TIME: &str = ".google.protobuf.Timestamp";

/// A schema's file: its name below its package's folder, what it imports, and its fields.
struct Schema {
    package: &'static str,
    name: &'static str,
    imports: &'static [&'static str],
    fields: &'static [Field],
}

/// In the order in which they import each other.
const SCHEMAS: [Schema; 9] = [
    Schema {
        package: "google.protobuf",
        name: "Timestamp",
        imports: &[],
        fields: &[field("seconds", 1, Type::Int64), field("nanos", 2, Type::Int32)],
    },
    Schema {
        package: "foxglove",
        name: "Vector3",
        imports: &[],
        fields: &[field("x", 1, Type::Double), field("y", 2, Type::Double), field("z", 3, Type::Double)],
    },
    Schema {
        package: "foxglove",
        name: "Quaternion",
        imports: &[],
        fields: &[
            field("x", 1, Type::Double),
            field("y", 2, Type::Double),
            field("z", 3, Type::Double),
            field("w", 4, Type::Double),
        ],
    },
    Schema {
        package: "foxglove",
        name: "Pose",
        imports: &["Quaternion", "Vector3"],
        fields: &[message("position", 1, ".foxglove.Vector3"), message("orientation", 2, ".foxglove.Quaternion")],
    },
    Schema {
        package: "foxglove",
        name: "RawImage",
        imports: &["Timestamp"],
        fields: &[
            message("timestamp", 1, TIME),
            field("frame_id", 7, Type::String),
            field("width", 2, Type::Fixed32),
            field("height", 3, Type::Fixed32),
            field("encoding", 4, Type::String),
            field("step", 5, Type::Fixed32),
            field("data", 6, Type::Bytes),
        ],
    },
    Schema {
        package: "foxglove",
        name: "CameraCalibration",
        imports: &["Timestamp"],
        fields: &[
            message("timestamp", 1, TIME),
            field("frame_id", 9, Type::String),
            field("width", 2, Type::Fixed32),
            field("height", 3, Type::Fixed32),
            field("distortion_model", 4, Type::String),
            doubles("D", 5),
            doubles("K", 6),
            doubles("R", 7),
            doubles("P", 8),
        ],
    },
    Schema {
        package: "foxglove",
        name: "PoseInFrame",
        imports: &["Pose", "Timestamp"],
        fields: &[
            message("timestamp", 1, TIME),
            field("frame_id", 2, Type::String),
            message("pose", 3, ".foxglove.Pose"),
        ],
    },
    Schema {
        package: "foxglove",
        name: "FrameTransform",
        imports: &["Quaternion", "Timestamp", "Vector3"],
        fields: &[
            message("timestamp", 1, TIME),
            field("parent_frame_id", 2, Type::String),
            field("child_frame_id", 3, Type::String),
            message("translation", 4, ".foxglove.Vector3"),
            message("rotation", 5, ".foxglove.Quaternion"),
        ],
    },
    Schema {
        package: "foxglove",
        name: "CompressedImage",
        imports: &["Timestamp"],
        fields: &[
            message("timestamp", 1, TIME),
            field("frame_id", 4, Type::String),
            field("data", 2, Type::Bytes),
            field("format", 3, Type::String),
        ],
    },
];

impl Schema {
    fn file(&self) -> String {
        let name = if self.package == "foxglove" { self.name.into() } else { self.name.to_lowercase() };
        format!("{}/{name}.proto", self.package.replace('.', "/"))
    }

    fn named(name: &str) -> Option<&'static Self> {
        SCHEMAS.iter().find(|schema| schema.name == name)
    }

    fn descriptor(&self) -> FileDescriptorProto {
        let field = |&(name, number, kind, label, of): &Field| FieldDescriptorProto {
            name: Some(name.into()),
            number: Some(number),
            label: Some(label.into()),
            r#type: Some(kind.into()),
            type_name: of.map(Into::into),
            ..FieldDescriptorProto::default()
        };
        let message = DescriptorProto {
            name: Some(self.name.into()),
            field: self.fields.iter().map(field).collect(),
            ..DescriptorProto::default()
        };
        FileDescriptorProto {
            name: Some(self.file()),
            package: Some(self.package.into()),
            dependency: self.imports.iter().filter_map(|name| Self::named(name)).map(Self::file).collect(),
            message_type: vec![message],
            syntax: Some("proto3".into()),
            ..FileDescriptorProto::default()
        }
    }

    fn reach(&self, files: &mut Vec<FileDescriptorProto>) {
        for import in self.imports.iter().filter_map(|name| Self::named(name)) {
            import.reach(files);
        }
        if files.iter().all(|file| file.name() != self.file()) {
            files.push(self.descriptor());
        }
    }
}

/// The schema of a message of Foxglove's as MCAP holds it: a `FileDescriptorSet` with all that it imports.
pub(super) fn schema(name: &str) -> Vec<u8> {
    let mut file = Vec::new();
    if let Some(schema) = Schema::named(name) {
        schema.reach(&mut file);
    }
    FileDescriptorSet { file }.encode_to_vec()
}
