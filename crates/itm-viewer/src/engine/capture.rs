//! Recording what the large pane shows.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use itm_slam::{Canvas, ColourImage, Device};

/// What pictures are recorded as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CaptureKind {
    /// A folder of PNG files.
    Frames,
    /// Motion JPEG in an AVI file, which players know without a codec of their own.
    Video,
}

/// Pictures a second that a video says it has.
const RATE_HZ: u32 = 30;
/// Longest a video may become: sizes are 32 bits.
const LARGEST_VIDEO: u64 = 1 << 31;

/// A recording under way.
pub(super) struct Capture {
    path: PathBuf,
    into: Into,
    pictures: u64,
    /// Pictures of another size than the video's.
    left_out: u64,
}

enum Into {
    Folder,
    Video(Option<Video>),
}

impl Capture {
    /// Begins to record into a folder, which is made, or into a file.
    pub(super) fn begin(kind: CaptureKind, path: &Path) -> Result<Self, String> {
        let failed = |error: io::Error| format!("cannot write '{}': {error}", path.display());
        let into = match kind {
            CaptureKind::Frames => {
                fs::create_dir_all(path).map_err(failed)?;
                if fs::read_dir(path).map_err(failed)?.next().is_some() {
                    return Err(format!("'{}' has files in it: pictures go into an empty folder", path.display()));
                }
                Into::Folder
            }
            CaptureKind::Video => {
                if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("avi")) {
                    return Err(format!("'{}' is no name of a video: expected one that ends in .avi", path.display()));
                }
                File::create(path).map_err(failed)?;
                Into::Video(None)
            }
        };
        Ok(Self { path: path.to_owned(), into, pictures: 0, left_out: 0 })
    }

    /// Takes in a picture; returns how many there are.
    pub(super) fn take(&mut self, device: &Device, canvas: &Canvas) -> Result<u64, String> {
        let picture = canvas.read(device).map_err(|error| error.to_string())?;
        self.add(&picture)?;
        Ok(self.pictures)
    }

    fn add(&mut self, picture: &ColourImage) -> Result<(), String> {
        let shown = self.path.display().to_string();
        let failed = |error: io::Error| format!("cannot write '{shown}': {error}");
        let rgb: Vec<u8> = picture.data().iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
        let (width, height) = picture.size();
        match &mut self.into {
            Into::Folder => {
                let mut png = Vec::new();
                let encoded = PngEncoder::new(&mut png).write_image(&rgb, width, height, ExtendedColorType::Rgb8);
                encoded.map_err(|error| error.to_string())?;
                fs::write(self.path.join(format!("{:06}.png", self.pictures)), png).map_err(failed)?;
            }
            Into::Video(video) => {
                let video = match video {
                    Some(video) => video,
                    None => video.insert(Video::create(&self.path, (width, height)).map_err(failed)?),
                };
                if video.size != (width, height) {
                    // A video has one size: another view, or another pane, has no place in it.
                    self.left_out += 1;
                    return Ok(());
                }
                let mut jpeg = Vec::new();
                let encoded =
                    JpegEncoder::new_with_quality(&mut jpeg, 92).encode(&rgb, width, height, ExtendedColorType::Rgb8);
                encoded.map_err(|error| error.to_string())?;
                video.add(&jpeg).map_err(failed)?;
            }
        }
        self.pictures += 1;
        Ok(())
    }

    /// Ends the recording, and says what there is.
    pub(super) fn finish(self) -> Result<String, String> {
        let shown = self.path.display();
        if let Into::Video(Some(video)) = self.into {
            video.finish().map_err(|error| format!("cannot write '{shown}': {error}"))?;
        }
        let left_out = match self.left_out {
            0 => String::new(),
            n => format!("; {n} of another size than the first were left out"),
        };
        Ok(format!("{} pictures are in {shown}{left_out}", self.pictures))
    }
}

/// Motion JPEG in an AVI file (Microsoft's RIFF; the OpenDML extensions for longer files are left out).
struct Video {
    file: BufWriter<File>,
    size: (u32, u32),
    /// Where each picture lies after the list's name, and its bytes.
    index: Vec<(u32, u32)>,
    /// Bytes of the list of pictures so far.
    bytes: u64,
    largest: u32,
}

/// Bytes before the list of pictures: RIFF's header, the list of headers.
const HEADERS: u32 = 12 + 12 + 64 + 12 + 64 + 48;

impl Video {
    fn create(path: &Path, size: (u32, u32)) -> io::Result<Self> {
        let mut video =
            Self { file: BufWriter::new(File::create(path)?), size, index: Vec::new(), bytes: 4, largest: 0 };
        // What is not known yet is written again at the end.
        video.write_headers()?;
        Ok(video)
    }

    fn write_headers(&mut self) -> io::Result<()> {
        let (width, height) = self.size;
        let pictures = self.index.len() as u32;
        let index_bytes = 8 + 16 * pictures;
        let list_bytes = self.bytes as u32;
        let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
        let mut out = Vec::new();
        out.extend(b"RIFF");
        out.extend(words(&[HEADERS - 8 + 8 + list_bytes + index_bytes]));
        out.extend(b"AVI LIST");
        out.extend(words(&[4 + 64 + 12 + 64 + 48]));
        out.extend(b"hdrlavih");
        // Microseconds a picture, bytes a second, padding, flags (has an index), pictures, none before, streams, buffer, size.
        let flags = 0x10;
        out.extend(words(&[
            56,
            1_000_000 / RATE_HZ,
            0,
            0,
            flags,
            pictures,
            0,
            1,
            self.largest,
            width,
            height,
            0,
            0,
            0,
            0,
        ]));
        out.extend(b"LIST");
        out.extend(words(&[4 + 64 + 48]));
        out.extend(b"strlstrh");
        out.extend(words(&[56]));
        out.extend(b"vidsMJPG");
        out.extend(words(&[0, 0, 0, 1, RATE_HZ, 0, pictures, self.largest, u32::MAX, 0]));
        let corner = |v: u32| (v as u16).to_le_bytes();
        out.extend([corner(0), corner(0), corner(width), corner(height)].concat());
        out.extend(b"strf");
        // A bitmap's header: its size, the picture's, one plane of 24 bits.
        out.extend(words(&[40, 40, width, height, 1 | 24 << 16]));
        out.extend(b"MJPG");
        out.extend(words(&[width * height * 3, 0, 0, 0, 0]));
        debug_assert_eq!(out.len() as u32, HEADERS);
        out.extend(b"LIST");
        out.extend(words(&[list_bytes]));
        out.extend(b"movi");
        self.file.write_all(&out)
    }

    fn add(&mut self, jpeg: &[u8]) -> io::Result<()> {
        if self.bytes + jpeg.len() as u64 + 9 > LARGEST_VIDEO {
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, "a video of 2 GiB is full; go on with another"));
        }
        let bytes = jpeg.len() as u32;
        self.file.write_all(b"00dc")?;
        self.file.write_all(&bytes.to_le_bytes())?;
        self.file.write_all(jpeg)?;
        // Chunks begin at even places.
        self.file.write_all(&[0][..jpeg.len() % 2])?;
        self.index.push((self.bytes as u32, bytes));
        self.bytes += 8 + u64::from(bytes.next_multiple_of(2));
        self.largest = self.largest.max(bytes);
        Ok(())
    }

    fn finish(mut self) -> io::Result<()> {
        self.file.write_all(b"idx1")?;
        self.file.write_all(&(16 * self.index.len() as u32).to_le_bytes())?;
        for (at, bytes) in &self.index {
            self.file.write_all(b"00dc")?;
            // Each can be shown without another.
            for word in [0x10, *at, *bytes] {
                self.file.write_all(&word.to_le_bytes())?;
            }
        }
        self.file.seek(SeekFrom::Start(0))?;
        self.write_headers()?;
        self.file.flush()
    }
}
