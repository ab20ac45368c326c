//! Maps as files, `room.itm`: what a session needs to go on, or another program to look at a map.
//!
//! A file is a sequence of sections, each of a tag of four letters, compressed and with checksums. `docs/MAP_FORMAT.md` has
//! it byte by byte. The same content makes the same bytes.
//!
//! ```no_run
//! use itm_core::{Calibration, DepthConversion, Intrinsics, Settings, Trajectory};
//! use itm_core::voxel::VoxelKind;
//! use itm_io::map_file::{MapHeader, MapReader, MapWriter, tag};
//!
//! let camera = Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5);
//! let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
//! let header = MapHeader::new(&Settings::default(), calibration, VoxelKind::default());
//! let mut writer = MapWriter::create("room.itm".as_ref(), &header)?;
//! writer.blocks::<itm_io::Error>(tag::BLOCKS, |sink| sink.unused())?;
//! writer.trajectory(&Trajectory::default())?;
//! writer.finish()?;
//!
//! let mut reader = MapReader::open("room.itm".as_ref())?;
//! println!("voxels of {} m", reader.header().voxel_size_m);
//! reader.blocks::<itm_io::Error>(tag::BLOCKS, |key, words| {
//!     println!("{key:?}: {} words", words.len());
//!     Ok(())
//! })?;
//! # Ok::<(), itm_io::Error>(())
//! ```

mod reader;
mod submaps;
#[cfg(test)]
mod tests;
mod writer;

use std::io::Read as _;
use std::path::Path;

use itm_core::voxel::VoxelKind;
use itm_core::{Calibration, Settings};
use serde::{Deserialize, Serialize};

use crate::Error;
pub use reader::{MapReader, SectionInfo};
pub use submaps::{SubmapPose, SubmapState};
pub use writer::{BlockSink, MapWriter};

/// What a section is called: four printable ASCII characters.
pub type Tag = [u8; 4];

/// The sections that have a meaning here. Any other tag may be given to bytes of one's own.
pub mod tag {
    use super::Tag;

    /// The header. Written by [`super::MapWriter::create`].
    pub const HEADER: Tag = *b"HEAD";
    /// Blocks on the device, in the order of their indices.
    pub const BLOCKS: Tag = *b"BLKS";
    /// Blocks of the host's store.
    pub const HOST_BLOCKS: Tag = *b"HOST";
    /// The trajectory.
    pub const TRAJECTORY: Tag = *b"TRAJ";
    /// Where the submaps lie in the world.
    pub const SUBMAPS: Tag = *b"SUBM";
    /// The end of the file. Written by [`super::MapWriter::finish`].
    pub const END: Tag = *b"END ";
}

/// The format's version, major and minor. A reader refuses a later major one; a later minor one only adds sections and
/// keys of the header, which are passed over.
pub const VERSION: (u16, u16) = (1, 0);

/// Whether a file, by its name or its first bytes, is a map.
pub fn is_map_file(path: &Path) -> bool {
    let begins_as_one = || {
        let mut first = [0; MAGIC.len()];
        std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut first)).is_ok() && first == MAGIC
    };
    let named = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("itm"));
    path.is_file() && (named || begins_as_one())
}

/// Begins as PNG's does, so that a transfer as text, or one of seven bits, shows at once.
const MAGIC: [u8; 8] = *b"\x89ITM\r\n\x1a\n";
/// Bytes before the first section: magic, version, checksum.
const PREFIX_BYTES: usize = 16;
const SECTION_HEADER_BYTES: usize = 32;
/// Lengths and checksum before each chunk's bytes.
const CHUNK_HEADER_BYTES: usize = 12;
/// Bytes of a chunk at most, before compression.
const CHUNK_BYTES: usize = 1 << 20;
/// Bytes of a trajectory's or a submap's pose, with the eight before it that say what it is the pose of.
const POSE_BYTES: usize = 64;

/// What is to be known of a map before its blocks are read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapHeader {
    /// Program and version that wrote the file. For people, not to decide by.
    pub generator: String,
    /// The settings of the run, as TOML, so that a map whose settings are not all known any more can be read.
    pub settings: String,
    /// Edge of a voxel in metres.
    pub voxel_size_m: f32,
    /// Truncation band in metres, which distances are in units of.
    pub truncation_m: f32,
    /// What a voxel holds.
    pub voxel_kind: VoxelKind,
    /// The cameras.
    pub calibration: Calibration,
    /// How much of what there is.
    #[serde(default)]
    pub counts: MapCounts,
    /// Whatever else is to be kept.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub extra: toml::Table,
}

/// How much a map holds. To be shown; a reader counts for itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct MapCounts {
    /// Frames that the map was made of.
    pub frames: u64,
    /// Blocks in [`tag::BLOCKS`], without unused indices.
    pub device_blocks: u64,
    /// Blocks in [`tag::HOST_BLOCKS`].
    pub host_blocks: u64,
}

impl MapHeader {
    /// A header of this program's version, without counts and extras.
    pub fn new(settings: &Settings, calibration: Calibration, voxel_kind: VoxelKind) -> Self {
        Self {
            generator: concat!("itm ", env!("CARGO_PKG_VERSION")).into(),
            settings: settings.to_toml(),
            voxel_size_m: settings.map.voxel_size_m,
            truncation_m: settings.map.truncation_m,
            voxel_kind,
            calibration,
            counts: MapCounts::default(),
            extra: toml::Table::new(),
        }
    }

    /// What would do and what was found, where a number cannot be meant.
    fn check(&self) -> Result<(), (String, String)> {
        for (name, value) in [("voxel_size_m", self.voxel_size_m), ("truncation_m", self.truncation_m)] {
            if !(value.is_finite() && value > 0.0) {
                return Err((format!("{name} to be positive and finite"), value.to_string()));
            }
        }
        self.calibration.validate().map_err(|reason| ("cameras that can be".into(), format!("that {reason}")))
    }
}

/// Where every section's running checksum begins.
fn checksum_seed(tag: Tag) -> u32 {
    crc32fast::hash(&tag)
}

/// A CRC-32 continued over further bytes.
fn checksum_over(before: u32, parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new_with_initial(before);
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

/// The start of a section, as in the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct SectionHeader {
    tag: Tag,
    /// Number of sections before, in the end section; 0 elsewhere.
    sections: u32,
    /// Bytes of the payload before compression.
    raw_bytes: u64,
    /// Bytes of the payload in the file: its chunks with their headers.
    stored_bytes: u64,
    /// The running checksum at the payload's end.
    checksum: u32,
}

impl SectionHeader {
    /// The end section behind so many others, with the checksum over their headers.
    fn end(sections: u32, checksum: u32) -> Self {
        Self { tag: tag::END, sections, checksum, ..Self::default() }
    }

    fn encode(&self) -> [u8; SECTION_HEADER_BYTES] {
        let mut bytes = [0; SECTION_HEADER_BYTES];
        bytes[..4].copy_from_slice(&self.tag);
        bytes[4..8].copy_from_slice(&self.sections.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.raw_bytes.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.stored_bytes.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.checksum.to_le_bytes());
        let own = crc32fast::hash(&bytes[..28]);
        bytes[28..].copy_from_slice(&own.to_le_bytes());
        bytes
    }

    /// `None` where the header's own checksum is wrong.
    fn decode(bytes: &[u8; SECTION_HEADER_BYTES]) -> Option<Self> {
        let header = Self {
            tag: le(&bytes[..4], |b| b),
            sections: le(&bytes[4..8], u32::from_le_bytes),
            raw_bytes: le(&bytes[8..16], u64::from_le_bytes),
            stored_bytes: le(&bytes[16..24], u64::from_le_bytes),
            checksum: le(&bytes[24..28], u32::from_le_bytes),
        };
        (header.encode() == *bytes).then_some(header)
    }
}

/// The number in exactly so many bytes.
fn le<const N: usize, T>(bytes: &[u8], from: fn([u8; N]) -> T) -> T {
    from(bytes.try_into().expect("callers cut out as many bytes as the number has"))
}

fn content(path: &Path, tag: Tag, expected: String, found: String) -> Error {
    Error::MapContent { path: path.to_path_buf(), place: name_of(tag), expected, found }
}

/// A section's name in errors.
fn name_of(tag: Tag) -> String {
    format!("section {}", tag.escape_ascii().to_string().trim_end())
}
