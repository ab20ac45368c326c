//! MCAP files made message by message, with ROS 2's messages in either byte order.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

pub(crate) const W: u32 = 16;
pub(crate) const H: u32 = 12;
pub(crate) const FRAMES: usize = 5;
pub(crate) const START_NS: i64 = 1_700_000_000_000_000_000;
pub(crate) const STEP_NS: i64 = 33_333_333;

/// Depth in millimetres, as `interchange.py` has it.
pub(crate) fn depth_at(frame: usize, x: u32, y: u32) -> u16 {
    if (x, y) == (0, 0) { 0 } else { (1000 + 10 * x + y) as u16 + frame as u16 }
}

/// Colour, likewise.
pub(crate) fn colour_at(frame: usize, x: u32, y: u32) -> [u8; 4] {
    [10 * x as u8, 20 * y as u8, 40 * frame as u8, 255]
}

/// All pixels, row by row.
pub(crate) fn pixels() -> impl Iterator<Item = (u32, u32)> {
    (0..H).flat_map(|y| (0..W).map(move |x| (x, y)))
}

/// A message in CDR.
pub(crate) struct Cdr {
    bytes: Vec<u8>,
    big_endian: bool,
}

macro_rules! put {
    ($name:ident, $type:ty) => {
        pub(crate) fn $name(mut self, value: $type) -> Self {
            // Aligned from behind the encapsulation's header.
            while (self.bytes.len() - 4) % size_of::<$type>() != 0 {
                self.bytes.push(0);
            }
            let bytes = if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
            self.bytes.extend(bytes);
            self
        }
    };
}

impl Cdr {
    pub(crate) fn new(big_endian: bool) -> Self {
        Self { bytes: vec![0, u8::from(!big_endian), 0, 0], big_endian }
    }

    put!(u8, u8);
    put!(u32, u32);
    put!(f64, f64);

    pub(crate) fn f64s(self, values: &[f64]) -> Self {
        values.iter().fold(self, |cdr, &value| cdr.f64(value))
    }

    pub(crate) fn data(self, data: &[u8]) -> Self {
        let mut cdr = self.u32(data.len() as u32);
        cdr.bytes.extend(data);
        cdr
    }

    pub(crate) fn string(self, text: &str) -> Self {
        self.data(&[text.as_bytes(), &[0]].concat())
    }

    pub(crate) fn header(self, time_ns: i64, frame: &str) -> Self {
        let (seconds, nanoseconds) = (time_ns.div_euclid(1_000_000_000), time_ns.rem_euclid(1_000_000_000));
        self.u32(seconds as u32).u32(nanoseconds as u32).string(frame)
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// `sensor_msgs/Image` of W x H pixels.
pub(crate) fn image(time_ns: i64, frame: &str, encoding: &str, big_endian: bool, step: u32, data: &[u8]) -> Vec<u8> {
    let cdr = Cdr::new(big_endian).header(time_ns, frame).u32(H).u32(W).string(encoding);
    cdr.u8(big_endian.into()).u32(step).data(data).finish()
}

/// `sensor_msgs/CompressedImage`.
pub(crate) fn compressed(time_ns: i64, frame: &str, format: &str, data: &[u8]) -> Vec<u8> {
    Cdr::new(false).header(time_ns, frame).string(format).data(data).finish()
}

/// `sensor_msgs/CameraInfo`.
pub(crate) struct Info {
    pub(crate) size: (u32, u32),
    pub(crate) model: &'static str,
    pub(crate) d: &'static [f64],
    pub(crate) binning: u32,
    /// x, y, height, width.
    pub(crate) region: [u32; 4],
}

pub(crate) const INFO: Info = Info { size: (W, H), model: "plumb_bob", d: &[], binning: 0, region: [0; 4] };

impl Info {
    pub(crate) fn message(&self, frame: &str, big_endian: bool) -> Vec<u8> {
        let Self { size: (width, height), model, d, binning, region } = *self;
        let cdr = Cdr::new(big_endian).header(START_NS, frame).u32(height).u32(width).string(model);
        let cdr = cdr.u32(d.len() as u32).f64s(d);
        let cdr = cdr.f64s(&[20.0, 0.0, 7.5, 0.0, 21.0, 5.5, 0.0, 0.0, 1.0]);
        let cdr = cdr.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let cdr = cdr.f64s(&[40.0, 0.0, 8.0, 0.0, 0.0, 41.0, 6.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let cdr = region.into_iter().fold(cdr.u32(binning).u32(binning), Cdr::u32);
        cdr.u8(0).finish()
    }
}

/// `geometry_msgs/PoseStamped` at a place along x.
pub(crate) fn pose(time_ns: i64, x: f64) -> Vec<u8> {
    Cdr::new(false).header(time_ns, "world").f64s(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).finish()
}

/// `tf2_msgs/TFMessage` of one motion along x.
pub(crate) fn transform(time_ns: i64, parent: &str, child: &str, x: f64) -> Vec<u8> {
    let cdr = Cdr::new(false).u32(1).header(time_ns, parent).string(child);
    cdr.f64s(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).finish()
}

/// A file under way.
pub(crate) struct Mcap {
    writer: Writer<File>,
    channels: BTreeMap<String, u16>,
}

impl Mcap {
    pub(crate) fn create(path: &Path) -> Self {
        Self { writer: WriteOptions::new().create(File::create(path).unwrap()).unwrap(), channels: BTreeMap::new() }
    }

    /// Adds a message of ROS 2, by its type without the package's `msg/`.
    pub(crate) fn put(&mut self, topic: &str, schema: &str, time_ns: i64, message: &[u8]) -> &mut Self {
        let (package, name) = schema.split_once('/').unwrap();
        self.put_as(topic, &format!("{package}/msg/{name}"), "cdr", time_ns, message)
    }

    pub(crate) fn put_as(&mut self, topic: &str, schema: &str, encoding: &str, ns: i64, message: &[u8]) -> &mut Self {
        let channel_id = *self.channels.entry(topic.into()).or_insert_with(|| {
            let schema = self.writer.add_schema(schema, "ros2msg", b"").unwrap();
            self.writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
        });
        let (log_time, publish_time) = (ns as u64, ns as u64);
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time };
        self.writer.write_to_known_channel(&header, message).unwrap();
        self
    }

    /// Depth images of a topic, one a step, with a calibration beside them.
    pub(crate) fn depth(&mut self, topic: &str, frame: &str) -> &mut Self {
        let (parent, _) = topic.rsplit_once('/').unwrap();
        self.put(&format!("{parent}/camera_info"), "sensor_msgs/CameraInfo", START_NS, &INFO.message(frame, false));
        for number in 0..FRAMES {
            let data: Vec<u8> = pixels().flat_map(|(x, y)| depth_at(number, x, y).to_le_bytes()).collect();
            let time = START_NS + number as i64 * STEP_NS;
            self.put(topic, "sensor_msgs/Image", time, &image(time, frame, "16UC1", false, 2 * W, &data));
        }
        self
    }

    /// Colour images, likewise, taken so long after depth.
    pub(crate) fn colour(&mut self, topic: &str, frame: &str, delay_ns: i64) -> &mut Self {
        let (parent, _) = topic.rsplit_once('/').unwrap();
        self.put(&format!("{parent}/camera_info"), "sensor_msgs/CameraInfo", START_NS, &INFO.message(frame, false));
        for number in 0..FRAMES {
            let data: Vec<u8> = pixels().flat_map(|(x, y)| colour_at(number, x, y).into_iter().take(3)).collect();
            let time = START_NS + number as i64 * STEP_NS + delay_ns;
            self.put(topic, "sensor_msgs/Image", time, &image(time, frame, "rgb8", false, 3 * W, &data));
        }
        self
    }

    pub(crate) fn finish(&mut self) {
        self.writer.finish().unwrap();
    }
}
