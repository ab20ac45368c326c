//! MCAP's records (<https://mcap.dev/spec>): one way through a file that remembers where messages lie, and a way to any of
//! them.
//!
//! The file is read by its records and not by its summary, so that one without a summary, or without its end, is read by the
//! same code: times of exposure stand within messages, which the summary knows nothing of. No more than a chunk is in memory.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::ops::{Deref, Range};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::mcap::MAGIC;
use ::mcap::records::{ChunkHeader, Record, op};
use itm_core::Timestamp;

use super::messages::{CameraInfo, Inertial, Kind, Purpose, StampedTransform};
use crate::Error;

/// More than this in one record or chunk, which are held in memory, counts as damage.
const MAX_BYTES: u64 = 1 << 30;
/// Enough of an image's message for its stamp.
const START_BYTES: usize = 64;
/// Decompressed chunks that are kept, as messages of a frame lie near each other.
const CACHED_BYTES: usize = 64 << 20;

/// Where a message's data lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// In the file as it is.
    File { offset: u64, length: u64 },
    /// In a compressed chunk, by its number and by bytes of what it decompresses to.
    Chunk { chunk: usize, offset: usize, length: usize },
}

/// A compressed chunk.
#[derive(Clone, Debug)]
struct Chunk {
    /// Of its data.
    offset: u64,
    compressed_bytes: u64,
    bytes: u64,
    compression: Compression,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Compression {
    Zstd,
    Lz4,
}

impl Compression {
    /// Decompresses up to `limit` bytes; what came before an error as well as the error.
    fn decompress(self, data: &[u8], limit: u64) -> (Vec<u8>, io::Result<()>) {
        let mut bytes = Vec::new();
        let read = match self {
            Self::Zstd => zstd::stream::read::Decoder::with_buffer(data)
                .and_then(|decoder| read_on(decoder.take(limit), &mut bytes)),
            Self::Lz4 => read_on(lz4_flex::frame::FrameDecoder::new(data).take(limit), &mut bytes),
        };
        (bytes, read)
    }
}

/// As `read_to_end`, which does not say what it leaves in the buffer after an error.
fn read_on(mut from: impl Read, bytes: &mut Vec<u8>) -> io::Result<()> {
    const STEP: usize = 1 << 18;
    loop {
        let start = bytes.len();
        bytes.resize(start + STEP, 0);
        let read = from.read(&mut bytes[start..]);
        bytes.truncate(start + *read.as_ref().unwrap_or(&0));
        match read {
            Ok(0) => return Ok(()),
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

/// An image's message.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImageAt {
    pub(super) place: Place,
    /// Of its header; of the log where that is damaged.
    pub(super) stamp: Timestamp,
    pub(super) log_time: Timestamp,
}

/// All messages of one name and kind.
#[derive(Debug)]
pub(super) struct Topic {
    pub(super) name: String,
    /// The schema's name.
    pub(super) schema: String,
    /// `cdr`, `protobuf`, `ros1` …
    pub(super) encoding: String,
    pub(super) kind: Option<Kind>,
    pub(super) count: usize,
    pub(super) images: Vec<ImageAt>,
    /// The first camera described here.
    pub(super) camera: Option<CameraInfo>,
    /// Whether a later one was another.
    pub(super) camera_changes: bool,
    pub(super) transforms: Vec<StampedTransform>,
    pub(super) inertial: Vec<Inertial>,
    /// Messages that could not be understood, and why the first could not.
    pub(super) damaged: usize,
    pub(super) damage: Option<String>,
}

impl Topic {
    pub(super) fn is_for(&self, purpose: Purpose) -> bool {
        self.kind.is_some_and(|kind| kind.purpose() == purpose)
    }

    fn take(&mut self, place: Place, log_time: Timestamp, data: &[u8], whole: bool) {
        self.count += 1;
        let Some(kind) = self.kind else { return };
        let taken = match kind.purpose() {
            Purpose::Image => {
                let stamp = match kind.image_stamp(data) {
                    Ok(None) if whole => kind.stamp_of_image(data),
                    stamp => stamp.map(|stamp| stamp.unwrap_or(log_time)),
                };
                // A damaged message is a frame that cannot be read, which says so when it is asked for.
                let stamp = stamp.unwrap_or(log_time);
                self.images.push(ImageAt { place, stamp, log_time });
                Ok(())
            }
            Purpose::Camera => kind.camera(data).map(|camera| match &self.camera {
                // Before a camera is set up it may send zeros.
                Some(first) if first.k[0] != 0.0 => self.camera_changes |= *first != camera,
                _ => self.camera = Some(camera),
            }),
            Purpose::Pose | Purpose::Transforms => kind.transforms(data).map(|all| self.transforms.extend(all)),
            Purpose::Inertial => super::cdr::inertial(data).map(|reading| self.inertial.push(reading)),
        };
        if let Err(reason) = taken {
            self.damaged += 1;
            self.damage.get_or_insert(reason);
        }
    }
}

/// What a way through a file found.
#[derive(Debug)]
pub(super) struct Index {
    /// In the order of their first mention.
    pub(super) topics: Vec<Topic>,
    /// Records of metadata, by their names.
    pub(super) metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// What a user should know of the file.
    pub(super) warnings: Vec<String>,
}

/// An MCAP file, open for reading.
pub(super) struct Container {
    path: PathBuf,
    file: BufReader<File>,
    length: u64,
    chunks: Vec<Chunk>,
    /// Decompressed, the last used ones last.
    cache: VecDeque<(usize, Arc<Vec<u8>>)>,
}

/// A message's data.
pub(super) struct Payload {
    bytes: Arc<Vec<u8>>,
    range: Range<usize>,
}

impl Deref for Payload {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[self.range.clone()]
    }
}

/// Whether a file begins as MCAP files do.
pub(super) fn begins_as_mcap(path: &Path) -> bool {
    let mut magic = [0; MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok() && magic == *MAGIC
}

/// Channels and schemas, by their numbers.
#[derive(Default)]
struct Tables {
    /// Name and encoding.
    schemas: HashMap<u16, (String, String)>,
    /// Index of the topic.
    channels: HashMap<u16, usize>,
    /// Messages of channels that are not known.
    strays: usize,
}

impl Tables {
    /// Takes note of a schema, a channel or metadata; of nothing else.
    fn note(&mut self, index: &mut Index, opcode: u8, body: &[u8]) -> Result<(), String> {
        match ::mcap::parse_record(opcode, body).map_err(|error| describe(&error))? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, (header.name, header.encoding));
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id);
                let schema = schema.map_or_else(String::new, |(name, _)| name.clone());
                // Files that were put together have several channels of one topic.
                let same = |topic: &Topic| {
                    topic.name == channel.topic && topic.schema == schema && topic.encoding == channel.message_encoding
                };
                let at = index.topics.iter().position(same).unwrap_or_else(|| {
                    index.topics.push(Topic {
                        kind: Kind::of(&channel.message_encoding, &schema),
                        name: channel.topic.clone(),
                        schema: schema.clone(),
                        encoding: channel.message_encoding.clone(),
                        count: 0,
                        images: Vec::new(),
                        camera: None,
                        camera_changes: false,
                        transforms: Vec::new(),
                        inertial: Vec::new(),
                        damaged: 0,
                        damage: None,
                    });
                    index.topics.len() - 1
                });
                self.channels.insert(channel.id, at);
            }
            Record::Metadata(metadata) => {
                index.metadata.insert(metadata.name, metadata.metadata);
            }
            _ => {}
        }
        Ok(())
    }
}

fn describe(error: &::mcap::McapError) -> String {
    use std::error::Error as _;
    error.source().map_or_else(|| error.to_string(), |source| format!("{error}: {source}"))
}

const RECORD_HEADER_BYTES: usize = 1 + 8;
const MESSAGE_HEADER_BYTES: usize = 2 + 4 + 8 + 8;

/// The channel and the time of logging of a message's header.
fn message_header(header: &[u8; MESSAGE_HEADER_BYTES]) -> (u16, Timestamp) {
    let channel = u16::from_le_bytes([header[0], header[1]]);
    let [_, _, _, _, _, _, log_time @ .., _, _, _, _, _, _, _, _] = *header;
    (channel, Timestamp(i64::try_from(u64::from_le_bytes(log_time)).unwrap_or(i64::MAX)))
}

fn record_header(header: &[u8; RECORD_HEADER_BYTES]) -> (u8, u64) {
    let [opcode, length @ ..] = *header;
    (opcode, u64::from_le_bytes(length))
}

impl Container {
    /// Opens a file and goes through all of it.
    pub(super) fn open(path: &Path) -> Result<(Self, Index), Error> {
        let file = File::open(path).map_err(|reason| match reason.kind() {
            ErrorKind::NotFound => Error::NotFound { path: path.to_path_buf() },
            _ => Error::io("open", path, reason),
        })?;
        let length = file.metadata().map_err(|reason| Error::io("read", path, reason))?.len();
        let file = BufReader::with_capacity(1 << 16, file);
        let mut container = Self { path: path.to_path_buf(), file, length, chunks: Vec::new(), cache: VecDeque::new() };
        let mut magic = [0; MAGIC.len()];
        let begins = length >= MAGIC.len() as u64 && container.read_exact(&mut magic).is_ok() && magic == *MAGIC;
        if !begins {
            return Err(container.unreadable("it does not begin as an MCAP file does"));
        }
        let mut index = Index { topics: Vec::new(), metadata: BTreeMap::new(), warnings: Vec::new() };
        container.walk(&mut index)?;
        Ok((container, index))
    }

    fn unreadable(&self, reason: impl Into<String>) -> Error {
        Error::Mcap { path: self.path.clone(), reason: reason.into() }
    }

    fn read_exact(&mut self, bytes: &mut [u8]) -> Result<(), Error> {
        self.file.read_exact(bytes).map_err(|reason| Error::io("read", &self.path, reason))
    }

    fn read_vec(&mut self, length: u64) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let read = self.file.by_ref().take(length).read_to_end(&mut bytes);
        read.map_err(|reason| Error::io("read", &self.path, reason))?;
        if bytes.len() as u64 == length {
            Ok(bytes)
        } else {
            Err(self.unreadable("it became shorter while it was read"))
        }
    }

    fn skip_to(&mut self, from: u64, to: u64) -> Result<(), Error> {
        let by = i64::try_from(to).unwrap_or(i64::MAX) - i64::try_from(from).unwrap_or(i64::MAX);
        self.file.seek_relative(by).map_err(|reason| Error::io("read", &self.path, reason))
    }

    fn walk(&mut self, index: &mut Index) -> Result<(), Error> {
        let mut tables = Tables::default();
        let mut at = MAGIC.len() as u64;
        let mut ended = false;
        let mut cut_off = None;
        while self.length - at >= RECORD_HEADER_BYTES as u64 {
            let mut header = [0; RECORD_HEADER_BYTES];
            self.read_exact(&mut header)?;
            let (opcode, length) = record_header(&header);
            let body = at + RECORD_HEADER_BYTES as u64;
            let end = body.saturating_add(length);
            let is_whole = end <= self.length;
            match opcode {
                op::DATA_END | op::FOOTER => {
                    ended = true;
                    break;
                }
                op::CHUNK => {
                    let there = end.min(self.length) - body;
                    let data_at = self.chunk(index, &mut tables, body, there, is_whole)?;
                    if let Some(data_at) = data_at {
                        // Records of a chunk without compression lie in the file like all others.
                        at = data_at;
                        continue;
                    }
                    if !is_whole {
                        cut_off = Some("a chunk");
                        break;
                    }
                    // Where the file is, a chunk does not say.
                    self.seek(end)?;
                }
                _ if !is_whole => {
                    cut_off = Some("a record");
                    break;
                }
                op::MESSAGE if length >= MESSAGE_HEADER_BYTES as u64 => {
                    let mut header = [0; MESSAGE_HEADER_BYTES];
                    self.read_exact(&mut header)?;
                    let offset = body + MESSAGE_HEADER_BYTES as u64;
                    self.message(index, &mut tables, &header, offset, end - offset)?;
                }
                op::SCHEMA | op::CHANNEL | op::METADATA if length <= MAX_BYTES => {
                    let record = self.read_vec(length)?;
                    if let Err(problem) = tables.note(index, opcode, &record) {
                        return Err(self.unreadable(format!("the record at byte {at} is damaged: {problem}")));
                    }
                }
                0 => {
                    // No record has this number: space that was reserved and never written, or what is no record at all.
                    cut_off = Some("a record");
                    break;
                }
                _ => self.skip_to(body, end)?,
            }
            at = end;
        }
        if !ended {
            let within = cut_off.map_or_else(String::new, |what| format!(" within {what}"));
            index
                .warnings
                .push(format!("it is cut off{within} after {} bytes: frames up to there are read", self.length));
        }
        if tables.strays > 0 {
            index
                .warnings
                .push(format!("{} messages of channels that it does not describe are left out", tables.strays));
        }
        Ok(())
    }

    fn seek(&mut self, to: u64) -> Result<(), Error> {
        self.file.seek(SeekFrom::Start(to)).map_err(|reason| Error::io("read", &self.path, reason))?;
        Ok(())
    }

    /// Takes note of a message that lies in the file as it is.
    fn message(
        &mut self,
        index: &mut Index,
        tables: &mut Tables,
        header: &[u8; MESSAGE_HEADER_BYTES],
        offset: u64,
        length: u64,
    ) -> Result<(), Error> {
        let (channel, log_time) = message_header(header);
        let Some(topic) = tables.channels.get(&channel).and_then(|&at| index.topics.get_mut(at)) else {
            tables.strays += 1;
            return self.skip_to(offset, offset + length);
        };
        let place = Place::File { offset, length };
        let start = match topic.kind.map(Kind::purpose) {
            None => 0,
            Some(Purpose::Image) => length.min(START_BYTES as u64),
            Some(_) => length.min(MAX_BYTES),
        };
        let mut data = self.read_vec(start)?;
        let mut read = start;
        if let Some(kind) = topic.kind.filter(|kind| kind.purpose() == Purpose::Image)
            && matches!(kind.image_stamp(&data), Ok(None))
            && length <= MAX_BYTES
        {
            data.extend(self.read_vec(length - start)?);
            read = length;
        }
        topic.take(place, log_time, &data, read == length);
        self.skip_to(offset + read, offset + length)
    }

    /// Takes note of a chunk whose record's first `there` bytes are there, which begin at `body`. Where its data begins, if
    /// that is not compressed.
    fn chunk(
        &mut self,
        index: &mut Index,
        tables: &mut Tables,
        body: u64,
        there: u64,
        is_whole: bool,
    ) -> Result<Option<u64>, Error> {
        let Some((header, offset)) = self.chunk_header(body, there)? else {
            if is_whole {
                return Err(self.unreadable(format!("the chunk at byte {body} is damaged")));
            }
            return Ok(None);
        };
        let compression = match header.compression.as_str() {
            "" => {
                self.seek(offset)?;
                return Ok(Some(offset));
            }
            "zstd" => Compression::Zstd,
            "lz4" => Compression::Lz4,
            other => {
                return Err(self.unreadable(format!(
                    "the chunk at byte {body} is compressed by '{other}': expected zstd, lz4 or nothing"
                )));
            }
        };
        let there = (body + there - offset).min(header.compressed_size);
        if there > MAX_BYTES || header.uncompressed_size > MAX_BYTES {
            let (size, most) = (header.uncompressed_size >> 20, MAX_BYTES >> 20);
            return Err(self.unreadable(format!("the chunk at byte {body} has {size} MiB; at most {most} are read")));
        }
        let data = self.read_vec(there)?;
        let (bytes, result) = compression.decompress(&data, header.uncompressed_size);
        if is_whole {
            let damage = match result {
                Err(error) => Some(error.to_string()),
                Ok(()) if bytes.len() as u64 != header.uncompressed_size => Some("it is too short".into()),
                Ok(()) if header.uncompressed_crc != 0 && crc32fast::hash(&bytes) != header.uncompressed_crc => {
                    index.warnings.push(format!("the chunk at byte {body} fails its checksum and is left out"));
                    return Ok(None);
                }
                Ok(()) => None,
            };
            if let Some(damage) = damage {
                let warning = format!("the chunk at byte {body} is damaged ({damage}): it is read up to there");
                index.warnings.push(warning);
            }
        }
        let chunk = self.chunks.len();
        self.chunks.push(Chunk { offset, compressed_bytes: there, bytes: bytes.len() as u64, compression });
        self.records_of_chunk(index, tables, chunk, &bytes)?;
        Ok(None)
    }

    fn chunk_header(&mut self, body: u64, there: u64) -> Result<Option<(ChunkHeader, u64)>, Error> {
        const FIXED_BYTES: u64 = 8 + 8 + 8 + 4 + 4 + 8;
        // Names of compressions are short.
        let start = self.read_vec(there.min(FIXED_BYTES + 64))?;
        let Some(name_bytes) = start.get(28..32).and_then(|bytes| bytes.first_chunk()) else { return Ok(None) };
        let header_bytes = FIXED_BYTES + u64::from(u32::from_le_bytes(*name_bytes));
        if header_bytes > start.len() as u64 {
            return Ok(None);
        }
        // The data is not there yet, and may be larger than what is.
        let mut header = start[..header_bytes as usize].to_vec();
        let size_at = header.len() - 8;
        let size = header[size_at..].first_chunk().map_or(0, |&bytes| u64::from_le_bytes(bytes));
        header[size_at..].fill(0);
        let Ok(Record::Chunk { header, .. }) = ::mcap::parse_record(op::CHUNK, &header) else { return Ok(None) };
        let offset = body + header_bytes;
        self.seek(offset)?;
        Ok(Some((ChunkHeader { compressed_size: size, ..header }, offset)))
    }

    fn records_of_chunk(
        &self,
        index: &mut Index,
        tables: &mut Tables,
        chunk: usize,
        bytes: &[u8],
    ) -> Result<(), Error> {
        let mut at = 0;
        while let Some((header, rest)) = bytes[at..].split_first_chunk() {
            let (opcode, length) = record_header(header);
            let body = at + RECORD_HEADER_BYTES;
            let Some(record) = usize::try_from(length).ok().and_then(|length| rest.get(..length)) else { break };
            match (opcode, record.split_first_chunk()) {
                (op::MESSAGE, Some((header, data))) => {
                    let (channel, log_time) = message_header(header);
                    let place = Place::Chunk { chunk, offset: body + MESSAGE_HEADER_BYTES, length: data.len() };
                    match tables.channels.get(&channel).and_then(|&at| index.topics.get_mut(at)) {
                        Some(topic) => topic.take(place, log_time, data, true),
                        None => tables.strays += 1,
                    }
                }
                (op::SCHEMA | op::CHANNEL, _) => {
                    if let Err(problem) = tables.note(index, opcode, record) {
                        let at = self.chunks.last().map_or(0, |chunk| chunk.offset);
                        let problem = format!("a record of the chunk at byte {at} is damaged: {problem}");
                        return Err(self.unreadable(problem));
                    }
                }
                _ => {}
            }
            at = body + record.len();
        }
        Ok(())
    }

    /// A message's data.
    pub(super) fn read(&mut self, place: Place) -> Result<Payload, Error> {
        match place {
            Place::File { offset, length } => {
                if length > MAX_BYTES {
                    return Err(self.unreadable(format!("a message of {} MiB is too large", length >> 20)));
                }
                self.seek(offset)?;
                let bytes = Arc::new(self.read_vec(length)?);
                Ok(Payload { range: 0..bytes.len(), bytes })
            }
            Place::Chunk { chunk, offset, length } => {
                let bytes = self.decompressed(chunk)?;
                let range = offset..offset + length;
                if range.end > bytes.len() {
                    return Err(self.unreadable("it changed while it was read"));
                }
                Ok(Payload { bytes, range })
            }
        }
    }

    fn decompressed(&mut self, chunk: usize) -> Result<Arc<Vec<u8>>, Error> {
        if let Some(at) = self.cache.iter().position(|&(cached, _)| cached == chunk)
            && let Some(cached) = self.cache.remove(at)
        {
            let bytes = Arc::clone(&cached.1);
            self.cache.push_back(cached);
            return Ok(bytes);
        }
        let Chunk { offset, compressed_bytes, bytes: expected, compression } = self.chunks[chunk].clone();
        self.seek(offset)?;
        let data = self.read_vec(compressed_bytes)?;
        // A damaged or cut-off chunk ends in an error behind what it was found to hold.
        let (bytes, _known) = compression.decompress(&data, expected);
        let bytes = Arc::new(bytes);
        self.cache.push_back((chunk, Arc::clone(&bytes)));
        let cached =
            |cache: &VecDeque<(usize, Arc<Vec<u8>>)>| cache.iter().map(|(_, bytes)| bytes.len()).sum::<usize>();
        // A frame's two images may lie in different chunks.
        while self.cache.len() > 2 && cached(&self.cache) > CACHED_BYTES {
            self.cache.pop_front();
        }
        Ok(bytes)
    }
}
