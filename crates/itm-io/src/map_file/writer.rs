use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use itm_core::Trajectory;
use itm_core::voxel::BlockKey;
use zstd::bulk::Compressor;

use super::{
    CHUNK_BYTES, CHUNK_HEADER_BYTES, MAGIC, MapHeader, SECTION_HEADER_BYTES, SectionHeader, SubmapPose, Tag, VERSION,
    checksum_over, checksum_seed, content, name_of, submaps, tag,
};
use crate::Error;
use crate::whole_file::WholeFile;

/// zstd's level. Higher ones gain little on voxels, whose low bits are noise, and take several times as long.
const LEVEL: i32 = 1;

/// Writes a map file, section by section.
///
/// The file takes its name only in [`MapWriter::finish`]: until then it stands beside it, as `.NAME.PROCESS.part`, and one
/// of that name stays as it is. Where anything goes wrong, or the writer is dropped, what was written is removed.
#[derive(Debug)]
pub struct MapWriter {
    path: PathBuf,
    block_words: usize,
    /// Tags written so far.
    tags: Vec<Tag>,
    /// Over the headers of the sections so far.
    headers_checksum: u32,
    /// `None` once something has gone wrong.
    out: Option<Output>,
}

impl MapWriter {
    /// Starts a file with its header.
    ///
    /// # Errors
    /// Where the header's numbers cannot be meant ([`Error::MapContent`]) or the file cannot be written.
    pub fn create(path: &Path, header: &MapHeader) -> Result<Self, Error> {
        header.check().map_err(|(expected, found)| content(path, tag::HEADER, expected, found))?;
        let text = toml::to_string(header)
            .map_err(|reason| content(path, tag::HEADER, "what TOML can hold".into(), reason.to_string()))?;
        let write_error = |reason| Error::io("write", path, reason);
        let mut file = WholeFile::create(path).map_err(write_error)?;
        file.write_all(&prefix(VERSION)).map_err(write_error)?;
        let compressor = Compressor::new(LEVEL).map_err(write_error)?;
        let mut writer = Self {
            path: path.to_path_buf(),
            block_words: header.voxel_kind.block_words(),
            tags: Vec::new(),
            headers_checksum: 0,
            out: Some(Output { file, compressor, chunk: Vec::with_capacity(CHUNK_BYTES), packed: Vec::new() }),
        };
        writer.section(tag::HEADER, |payload| payload.write(text.as_bytes()))?;
        Ok(writer)
    }

    /// Writes a section of blocks as `produce` hands them over. A block goes to the file before the next one is asked for,
    /// so memory does not grow with their number.
    ///
    /// # Errors
    /// Those of `produce`, and where the file cannot be written (a full disk is an [`Error::Io`] whose reason says so).
    /// Nothing more can be written then.
    ///
    /// # Panics
    /// Where the tag is not four printable ASCII characters, or was written before.
    pub fn blocks<E: From<Error>>(
        &mut self,
        tag: Tag,
        produce: impl FnOnce(&mut BlockSink<'_, '_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let block_words = self.block_words;
        self.section(tag, |payload| produce(&mut BlockSink { payload, tag, block_words, record: Vec::new() }))
    }

    /// Writes the trajectory, to the bit.
    ///
    /// # Errors
    /// Where the file cannot be written.
    ///
    /// # Panics
    /// Where it was written before.
    pub fn trajectory(&mut self, trajectory: &Trajectory) -> Result<(), Error> {
        self.section(tag::TRAJECTORY, |payload| {
            for pose in trajectory.poses() {
                let mut bytes = submaps::pose_bytes(&pose.world_from_camera);
                bytes[..8].copy_from_slice(&pose.timestamp.0.to_le_bytes());
                payload.write(&bytes)?;
            }
            Ok(())
        })
    }

    /// Writes where the submaps lie, to the bit. Without this, all of them are at the world's origin.
    ///
    /// # Errors
    /// Where a pose is none or a submap has two ([`Error::MapContent`]), or the file cannot be written.
    ///
    /// # Panics
    /// Where they were written before.
    pub fn submaps(&mut self, submaps: &[SubmapPose]) -> Result<(), Error> {
        submaps::check(submaps).map_err(|(expected, found)| content(&self.path, tag::SUBMAPS, expected, found))?;
        self.section(tag::SUBMAPS, |payload| submaps.iter().try_for_each(|s| payload.write(&submaps::encode(s))))
    }

    /// Writes a section of bytes whose meaning is the caller's.
    ///
    /// # Errors
    /// Where the file cannot be written.
    ///
    /// # Panics
    /// Where the tag is not four printable ASCII characters, or was written before.
    pub fn bytes(&mut self, tag: Tag, bytes: &[u8]) -> Result<(), Error> {
        self.section(tag, |payload| payload.write(bytes))
    }

    /// Writes the end, brings the file to the disk and gives it its name.
    ///
    /// # Errors
    /// Where the file cannot be written, or an earlier section failed. A file of the name is as it was then.
    pub fn finish(mut self) -> Result<(), Error> {
        let sections = u32::try_from(self.tags.len()).expect("nobody writes 2^32 sections");
        let end = SectionHeader::end(sections, self.headers_checksum);
        let written = match self.out.take() {
            Some(mut out) => out.file.write_all(&end.encode()).and_then(|()| out.file.finish()),
            None => Err(gave_up()),
        };
        written.map_err(|reason| Error::io("write", &self.path, reason))
    }

    fn section<E: From<Error>>(
        &mut self,
        tag: Tag,
        produce: impl FnOnce(&mut Payload<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        assert!(tag.iter().all(|c| (b' '..=b'~').contains(c)), "{} has a name in printable ASCII", name_of(tag));
        assert!(tag != tag::END && !self.tags.contains(&tag), "{} is there once", name_of(tag));
        let path = &self.path;
        // Taken out for as long, so that it is gone where anything fails.
        let mut out = self.out.take().ok_or_else(|| Error::io("write", path, gave_up()))?;
        let write_error = |reason| Error::io("write", path, reason);

        // Lengths and checksum are known at the end only.
        let start = out.file.stream_position().map_err(write_error)?;
        out.file.write_all(&[0; SECTION_HEADER_BYTES]).map_err(write_error)?;
        let header = SectionHeader { tag, checksum: checksum_seed(tag), ..SectionHeader::default() };
        let mut payload = Payload { out: &mut out, path, header };
        produce(&mut payload)?;
        payload.end_chunk()?;
        let header = payload.header.encode();
        let end = start + (SECTION_HEADER_BYTES as u64) + payload.header.stored_bytes;
        out.file
            .seek(SeekFrom::Start(start))
            .and_then(|_| out.file.write_all(&header))
            .and_then(|()| out.file.seek(SeekFrom::Start(end)))
            .map_err(write_error)?;

        self.headers_checksum = checksum_over(self.headers_checksum, &[&header]);
        self.tags.push(tag);
        self.out = Some(out);
        Ok(())
    }
}

/// What stands before the first section of a file of a version.
pub(super) fn prefix(version: (u16, u16)) -> Vec<u8> {
    let mut prefix = MAGIC.to_vec();
    prefix.extend_from_slice(&version.0.to_le_bytes());
    prefix.extend_from_slice(&version.1.to_le_bytes());
    let checksum = crc32fast::hash(&prefix);
    prefix.extend_from_slice(&checksum.to_le_bytes());
    prefix
}

fn gave_up() -> io::Error {
    io::Error::other("an earlier section could not be written")
}

struct Output {
    file: WholeFile,
    compressor: Compressor<'static>,
    /// Bytes that wait until a chunk is full.
    chunk: Vec<u8>,
    packed: Vec<u8>,
}

impl std::fmt::Debug for Output {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // The compressor has nothing to show.
        f.debug_struct("Output").field("file", &self.file).finish_non_exhaustive()
    }
}

/// A section's payload while it is written.
struct Payload<'a> {
    out: &'a mut Output,
    path: &'a Path,
    /// Lengths and checksum so far.
    header: SectionHeader,
}

impl Payload<'_> {
    fn write(&mut self, mut bytes: &[u8]) -> Result<(), Error> {
        while !bytes.is_empty() {
            let (now, later) = bytes.split_at(bytes.len().min(CHUNK_BYTES - self.out.chunk.len()));
            self.out.chunk.extend_from_slice(now);
            bytes = later;
            if self.out.chunk.len() == CHUNK_BYTES {
                self.end_chunk()?;
            }
        }
        Ok(())
    }

    /// Writes what waits as a chunk.
    fn end_chunk(&mut self) -> Result<(), Error> {
        self.write_chunk().map_err(|reason| Error::io("write", self.path, reason))
    }

    fn write_chunk(&mut self) -> io::Result<()> {
        let Output { file, compressor, chunk, packed } = &mut *self.out;
        if chunk.is_empty() {
            return Ok(());
        }
        packed.clear();
        packed.reserve(zstd::zstd_safe::compress_bound(chunk.len()));
        compressor.compress_to_buffer(chunk.as_slice(), packed)?;
        // Noise is stored as it is, so that a chunk is never longer than its bytes.
        let stored = if packed.len() < chunk.len() { &*packed } else { &*chunk };
        // Both are a chunk's length at most.
        let lengths = [(chunk.len() as u32).to_le_bytes(), (stored.len() as u32).to_le_bytes()];
        self.header.checksum = checksum_over(self.header.checksum, &[lengths.as_flattened(), stored]);
        self.header.raw_bytes += chunk.len() as u64;
        self.header.stored_bytes += (CHUNK_HEADER_BYTES + stored.len()) as u64;
        file.write_all(lengths.as_flattened())?;
        file.write_all(&self.header.checksum.to_le_bytes())?;
        file.write_all(stored)?;
        chunk.clear();
        Ok(())
    }
}

/// Takes the blocks of a section.
pub struct BlockSink<'a, 'p> {
    payload: &'a mut Payload<'p>,
    tag: Tag,
    block_words: usize,
    record: Vec<u8>,
}

impl BlockSink<'_, '_> {
    /// The next block.
    ///
    /// # Errors
    /// Where the number of words is not that of the header's voxel kind ([`Error::MapContent`]), or the file cannot be
    /// written.
    ///
    /// # Panics
    /// Where the key is [`BlockKey::NO_KEY`].
    pub fn block(&mut self, key: BlockKey, words: &[u32]) -> Result<(), Error> {
        assert_ne!(key.pack(), BlockKey::NO_KEY, "no block has this key");
        if words.len() != self.block_words {
            let expected = format!("blocks of {} words, as of the voxel kind", self.block_words);
            return Err(content(self.payload.path, self.tag, expected, format!("one of {}", words.len())));
        }
        self.record(key.pack(), words)
    }

    /// An index that no block has.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn unused(&mut self) -> Result<(), Error> {
        self.record(BlockKey::NO_KEY, &[])
    }

    fn record(&mut self, key: [u32; 2], words: &[u32]) -> Result<(), Error> {
        self.record.clear();
        self.record.extend(key.iter().chain(words).flat_map(|w| w.to_le_bytes()));
        self.payload.write(&self.record)
    }
}

impl std::fmt::Debug for BlockSink<'_, '_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BlockSink").field("tag", &name_of(self.tag)).finish_non_exhaustive()
    }
}
