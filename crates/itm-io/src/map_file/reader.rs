use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use itm_core::voxel::BlockKey;
use itm_core::{StampedPose, Timestamp, Trajectory};
use zstd::bulk::Decompressor;

use super::{
    CHUNK_BYTES, CHUNK_HEADER_BYTES, MAGIC, MapHeader, POSE_BYTES, PREFIX_BYTES, SECTION_HEADER_BYTES, SectionHeader,
    SubmapPose, Tag, VERSION, checksum_over, checksum_seed, content, le, name_of, submaps, tag, writer,
};
use crate::Error;

/// Reads a map file, section by section.
///
/// No length in a file is believed before the bytes are there: memory is taken chunk by chunk, 1 MiB each at most. What a
/// reader hands on has passed its checksum.
#[derive(Debug)]
pub struct MapReader {
    path: PathBuf,
    file: BufReader<File>,
    version: (u16, u16),
    header: MapHeader,
    sections: Vec<Section>,
}

#[derive(Clone, Copy, Debug)]
struct Section {
    header: SectionHeader,
    /// Where the payload begins, from the file's start.
    at: u64,
}

/// A section that a file has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SectionInfo {
    /// What it is called.
    pub tag: Tag,
    /// Bytes of its content.
    pub raw_bytes: u64,
    /// Bytes that it takes in the file, its chunks' headers included.
    pub stored_bytes: u64,
}

impl MapReader {
    /// Opens a file and reads all that is outside of the sections' content, to the file's end, and the header.
    ///
    /// # Errors
    /// Where the file cannot be read, is no map ([`Error::NotAMap`]) or one of a later version ([`Error::MapVersion`]), is
    /// cut off ([`Error::MapCutOff`]) or damaged ([`Error::MapDamaged`]), or has a header that cannot be used
    /// ([`Error::MapContent`]).
    pub fn open(path: &Path) -> Result<Self, Error> {
        let file = File::open(path).map_err(|e| Error::io("open", path, e))?;
        let mut file = BufReader::with_capacity(CHUNK_BYTES, file);
        let mut source = Source { path, file: &mut file };
        let length = source.file.seek(SeekFrom::End(0)).map_err(|e| Error::io("read", path, e))?;
        let version = source.check_prefix(length)?;
        let sections = source.read_sections(length)?;
        let section = find(path, &sections, tag::HEADER)?;
        let mut text = Vec::new();
        source.chunks(&section, |bytes| -> Result<(), Error> {
            text.extend_from_slice(bytes);
            Ok(())
        })?;
        let unusable = |(expected, found)| content(path, tag::HEADER, expected, found);
        let text = String::from_utf8(text).map_err(|e| unusable(("UTF-8".into(), e.to_string())))?;
        let header: MapHeader = toml::from_str(&text)
            .map_err(|e| unusable(("the header's keys".into(), format!("that {}", e.to_string().trim_end()))))?;
        header.check().map_err(unusable)?;
        Ok(Self { path: path.to_path_buf(), file, version, header, sections })
    }

    /// The version of the file's format, major and minor.
    pub fn version(&self) -> (u16, u16) {
        self.version
    }

    /// The header.
    pub fn header(&self) -> &MapHeader {
        &self.header
    }

    /// Whether there is a section of this tag.
    pub fn has(&self, tag: Tag) -> bool {
        self.sections.iter().any(|s| s.header.tag == tag)
    }

    /// All sections in the file's order, those that nothing is known of included.
    pub fn sections(&self) -> impl ExactSizeIterator<Item = SectionInfo> + '_ {
        self.sections.iter().map(|Section { header: h, .. }| SectionInfo {
            tag: h.tag,
            raw_bytes: h.raw_bytes,
            stored_bytes: h.stored_bytes,
        })
    }

    /// Hands over the blocks of a section in its order: key and words, [`itm_core::voxel::VoxelKind::block_words`] of the
    /// header's kind; or `None` and no words for an index that no block has. Returns their number, unused ones included.
    ///
    /// # Errors
    /// Those of `consume`; where there is no such section ([`Error::NoMapSection`]), it is damaged, or its content is not
    /// of whole blocks ([`Error::MapContent`]). Blocks before the damage have been handed over by then.
    pub fn blocks<E: From<Error>>(
        &mut self,
        tag: Tag,
        mut consume: impl FnMut(Option<BlockKey>, &[u32]) -> Result<(), E>,
    ) -> Result<u64, E> {
        const KEY_BYTES: usize = 8;
        let block_bytes = self.header.voxel_kind.block_words() * 4;
        let (mut words, mut pending, mut count) = (Vec::new(), Vec::new(), 0);
        self.chunks(tag, |bytes| {
            pending.extend_from_slice(bytes);
            let mut rest = pending.as_slice();
            while let Some((key, behind)) = rest.split_at_checked(KEY_BYTES) {
                let key = [le(&key[..4], u32::from_le_bytes), le(&key[4..], u32::from_le_bytes)];
                let used = key != BlockKey::NO_KEY;
                let Some((block, behind)) = behind.split_at_checked(if used { block_bytes } else { 0 }) else { break };
                words.clear();
                words.extend(block.chunks_exact(4).map(|w| le(w, u32::from_le_bytes)));
                consume(used.then(|| BlockKey::unpack(key)), &words)?;
                count += 1;
                rest = behind;
            }
            let done = pending.len() - rest.len();
            pending.drain(..done);
            Ok::<(), E>(())
        })?;
        if !pending.is_empty() {
            let found = format!("{} bytes behind block {count}", pending.len());
            return Err(content(&self.path, tag, format!("blocks of {block_bytes} bytes"), found).into());
        }
        Ok(count)
    }

    /// The trajectory, to the bit.
    ///
    /// # Errors
    /// Where there is none ([`Error::NoMapSection`]), its section is damaged, or what it holds are no poses
    /// ([`Error::MapContent`]).
    pub fn trajectory(&mut self) -> Result<Trajectory, Error> {
        let poses = self.poses(tag::TRAJECTORY)?;
        let pose = |(i, bytes): (usize, &[u8; POSE_BYTES])| {
            let world_from_camera = submaps::checked_pose_in(bytes).map_err(|reason| {
                content(&self.path, tag::TRAJECTORY, "poses".into(), format!("that pose {i} is none: {reason}"))
            })?;
            Ok(StampedPose { timestamp: Timestamp(le(&bytes[..8], i64::from_le_bytes)), world_from_camera })
        };
        poses.iter().enumerate().map(pose).collect()
    }

    /// Where the submaps lie, in the file's order and to the bit; none where the file does not say, and then all of them are at
    /// the world's origin.
    ///
    /// # Errors
    /// Where the section is damaged, a pose is none, a submap has two, or its state is not known ([`Error::MapContent`]).
    pub fn submaps(&mut self) -> Result<Vec<SubmapPose>, Error> {
        if !self.has(tag::SUBMAPS) {
            return Ok(Vec::new());
        }
        let poses = self.poses(tag::SUBMAPS)?;
        let submaps = poses.iter().map(submaps::decode).collect::<Result<Vec<_>, _>>();
        let checked = submaps.and_then(|submaps| submaps::check(&submaps).map(|()| submaps));
        checked.map_err(|(expected, found)| content(&self.path, tag::SUBMAPS, expected, found))
    }

    /// The content of a section of poses.
    fn poses(&mut self, tag: Tag) -> Result<Vec<[u8; POSE_BYTES]>, Error> {
        let bytes = self.bytes(tag)?;
        let (poses, rest) = bytes.as_chunks::<POSE_BYTES>();
        if !rest.is_empty() {
            let expected = format!("poses of {POSE_BYTES} bytes");
            return Err(content(&self.path, tag, expected, format!("{} bytes", bytes.len())));
        }
        Ok(poses.to_vec())
    }

    /// The content of a section as a whole.
    ///
    /// # Errors
    /// Where there is no such section ([`Error::NoMapSection`]) or it is damaged.
    pub fn bytes(&mut self, tag: Tag) -> Result<Vec<u8>, Error> {
        let mut all = Vec::new();
        self.chunks(tag, |bytes| {
            all.extend_from_slice(bytes);
            Ok::<(), Error>(())
        })?;
        Ok(all)
    }

    /// Reads the whole file and checks every checksum.
    ///
    /// # Errors
    /// The first section that is damaged.
    pub fn verify(&mut self) -> Result<(), Error> {
        let tags: Vec<Tag> = self.sections().map(|s| s.tag).collect();
        tags.into_iter().try_for_each(|tag| self.chunks(tag, |_| Ok(())))
    }

    fn chunks<E: From<Error>>(&mut self, tag: Tag, consume: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        let section = find(&self.path, &self.sections, tag)?;
        Source { path: &self.path, file: &mut self.file }.chunks(&section, consume)
    }
}

fn find(path: &Path, sections: &[Section], tag: Tag) -> Result<Section, Error> {
    let missing = || Error::NoMapSection { path: path.to_path_buf(), section: name_of(tag) };
    sections.iter().find(|s| s.header.tag == tag).copied().ok_or_else(missing)
}

/// A file while it is read, with the path that errors name.
struct Source<'a> {
    path: &'a Path,
    file: &'a mut BufReader<File>,
}

impl Source<'_> {
    fn read(&mut self, bytes: &mut [u8], within: impl Fn() -> String) -> Result<(), Error> {
        self.file.read_exact(bytes).map_err(|e| match e.kind() {
            io::ErrorKind::UnexpectedEof => {
                let length = self.file.get_ref().metadata().map_or(0, |m| m.len());
                self.cut_off(length, within())
            }
            _ => Error::io("read", self.path, e),
        })
    }

    fn seek(&mut self, to: u64) -> Result<(), Error> {
        self.file.seek(SeekFrom::Start(to)).map_err(|e| Error::io("read", self.path, e))?;
        Ok(())
    }

    fn cut_off(&self, length: u64, within: String) -> Error {
        Error::MapCutOff { path: self.path.to_path_buf(), length, within }
    }

    fn damaged(&self, place: String, problem: impl Into<String>) -> Error {
        Error::MapDamaged { path: self.path.to_path_buf(), place, problem: problem.into() }
    }

    fn check_prefix(&mut self, length: u64) -> Result<(u16, u16), Error> {
        let not_a_map = || Error::NotAMap { path: self.path.to_path_buf() };
        let mut prefix = [0; PREFIX_BYTES];
        let there = length.min(PREFIX_BYTES as u64) as usize;
        if there == 0 {
            return Err(not_a_map());
        }
        self.seek(0)?;
        self.read(&mut prefix[..there], || "the file's start".into())?;
        if prefix[..there.min(8)] != MAGIC[..there.min(8)] {
            return Err(Error::NotAMap { path: self.path.to_path_buf() });
        }
        if there < PREFIX_BYTES {
            return Err(self.cut_off(length, "the file's start".into()));
        }
        let version = (le(&prefix[8..10], u16::from_le_bytes), le(&prefix[10..12], u16::from_le_bytes));
        // First, as all that follows may be otherwise in a later version.
        if version.0 > VERSION.0 {
            return Err(Error::MapVersion { path: self.path.to_path_buf(), found: version, supported: VERSION });
        }
        if prefix[..] != writer::prefix(version) || version.0 == 0 {
            return Err(self.damaged("the file's start".into(), "its checksum is wrong"));
        }
        Ok(version)
    }

    /// All sections before the end section, behind which the file of so many bytes has to end.
    fn read_sections(&mut self, length: u64) -> Result<Vec<Section>, Error> {
        let mut sections: Vec<Section> = Vec::new();
        let mut checksum = 0;
        let mut at = PREFIX_BYTES as u64;
        loop {
            self.seek(at)?;
            let mut bytes = [0; SECTION_HEADER_BYTES];
            let number = sections.len();
            self.read(&mut bytes, || format!("the header of section number {number}"))?;
            let Some(header) = SectionHeader::decode(&bytes) else {
                return Err(self.damaged(format!("the section header at byte {at}"), "its checksum is wrong"));
            };
            at += SECTION_HEADER_BYTES as u64;
            if header.tag == tag::END {
                if header != SectionHeader::end(number as u32, checksum) || at != length {
                    return Err(self.damaged("the file's end".into(), "it is not that of the sections before"));
                }
                return Ok(sections);
            }
            if sections.iter().any(|s| s.header.tag == header.tag) {
                return Err(self.damaged(name_of(header.tag), "it is there twice"));
            }
            let end = at.saturating_add(header.stored_bytes);
            if end > length {
                return Err(self.cut_off(length, name_of(header.tag)));
            }
            sections.push(Section { header, at });
            checksum = checksum_over(checksum, &[&bytes]);
            at = end;
        }
    }

    /// Hands over a section's content chunk by chunk, each after its checksum.
    fn chunks<E: From<Error>>(
        &mut self,
        section: &Section,
        mut consume: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let header = &section.header;
        let name = || name_of(header.tag);
        let wrong_lengths = "its lengths do not fit together";
        let mut decompressor = Decompressor::new().map_err(|e| Error::io("read", self.path, e))?;
        let (mut stored, mut raw) = (Vec::new(), Vec::new());
        let (mut checksum, mut raw_bytes, mut left) = (checksum_seed(header.tag), 0, header.stored_bytes);
        self.seek(section.at)?;
        while left > 0 {
            let mut bytes = [0; CHUNK_HEADER_BYTES];
            let Some(behind) = left.checked_sub(CHUNK_HEADER_BYTES as u64) else {
                return Err(self.damaged(name(), wrong_lengths).into());
            };
            self.read(&mut bytes, name)?;
            let (lengths, expected) = bytes.split_at(8);
            let raw_length = le(&lengths[..4], u32::from_le_bytes) as usize;
            let stored_length = le(&lengths[4..], u32::from_le_bytes) as usize;
            // Checked before they are believed, though the checksum over them comes behind.
            let plausible = raw_length <= CHUNK_BYTES && (1..=raw_length).contains(&stored_length);
            left = match behind.checked_sub(stored_length as u64) {
                Some(left) if plausible => left,
                _ => return Err(self.damaged(name(), wrong_lengths).into()),
            };
            stored.resize(stored_length, 0);
            self.read(&mut stored, name)?;
            checksum = checksum_over(checksum, &[lengths, &stored]);
            if checksum.to_le_bytes() != expected {
                return Err(self.damaged(name(), "its checksum is wrong").into());
            }
            let content = if stored_length == raw_length {
                &stored
            } else {
                raw.clear();
                raw.reserve(raw_length);
                decompressor
                    .decompress_to_buffer(&stored, &mut raw)
                    .ok()
                    .filter(|n| *n == raw_length)
                    .ok_or_else(|| self.damaged(name(), "it cannot be decompressed"))?;
                &raw
            };
            raw_bytes += raw_length as u64;
            consume(content)?;
        }
        if (raw_bytes, checksum) != (header.raw_bytes, header.checksum) {
            return Err(self.damaged(name(), wrong_lengths).into());
        }
        Ok(())
    }
}
