//! Recordings: depth images, mostly with colour, often with true poses, in the formats that people have them in.
//!
//! [`open`] recognises the format from the folder, and [`ReadAhead`] decodes frames on another thread. Everything is
//! converted to the conventions of [`itm_core`] here: metres, nanoseconds, poses of the depth camera as
//! `world_from_camera`.
//!
//! | format | recognised by | cameras | time |
//! | --- | --- | --- | --- |
//! | TUM RGB-D | `depth.txt` and `rgb.txt`, or `associations.txt` | preset by `fr1`, `fr2`, `fr3` in the path | of the depth image |
//! | ICL-NUIM | `*.gt.freiburg`, or numbered images below a telling name | preset | nominal |
//! | 7-Scenes | `frame-000000.depth.png`, or one `seq-01` folder with such | preset | nominal |
//! | MCAP | a file `*.mcap` or one that begins as such, or the one in a folder | messages or calibration file | of the depth image |
//! | image folder | a calibration file, or a pattern | calibration file | nominal |
//!
//! A folder in TUM's format may hold a gyroscope's readings: `gyroscope.txt`, lines of `timestamp wx wy wz` in seconds and
//! rad/s. Each frame has those since the frame before it in the recording; the first one the last before it.
//!
//! In MCAP, messages of ROS 2 (`sensor_msgs/msg/Image`, `CompressedImage`, `CameraInfo`, `Imu`; poses from `tf2_msgs`,
//! `geometry_msgs` and `nav_msgs`) and of Foxglove's schemas in protobuf are read; [`Topics`] chooses between topics, and
//! [`McapWriter`] writes such files.
//!
//! A calibration file (`calibration.txt` or `calib.txt`, see [`crate::calibration`]) in the folder wins over a preset.

mod decode;
mod icl_nuim;
mod images;
mod mcap;
mod read_ahead;
mod seven_scenes;
mod tum;

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use itm_core::{AngularRate, Calibration, DepthImage, Frame, Se3, Timestamp, Trajectory};

use self::images::Key;
use crate::{Error, calibration, matrix};

pub(crate) use images::{Pattern, Varying};

pub use mcap::{McapWriter, Topics};
pub use read_ahead::ReadAhead;

/// A format of recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Sturm et al. 2012, *A Benchmark for the Evaluation of RGB-D SLAM Systems*.
    Tum,
    /// Handa et al. 2014, *A Benchmark for RGB-D Visual Odometry, 3D Reconstruction and SLAM*, in its TUM-like form.
    IclNuim,
    /// Shotton et al. 2013, *Scene Coordinate Regression Forests for Camera Relocalization in RGB-D Images*.
    SevenScenes,
    /// Messages in an MCAP file (<https://mcap.dev>), as robots record them.
    Mcap,
    /// Image files that match a pattern, with a calibration file.
    Images,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 5] = [Self::Tum, Self::IclNuim, Self::SevenScenes, Self::Mcap, Self::Images];

    /// The name by which it can be asked for: `tum`, `icl-nuim`, `7-scenes`, `mcap`, `images`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tum => "tum",
            Self::IclNuim => "icl-nuim",
            Self::SevenScenes => "7-scenes",
            Self::Mcap => "mcap",
            Self::Images => "images",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Format {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL
            .into_iter()
            .find(|format| format.name() == name)
            .ok_or_else(|| Error::FormatName { given: name.into(), known: Self::ALL.map(Self::name).join(", ") })
    }
}

/// What to open a recording with, where its folder does not say it all.
#[derive(Clone, Debug, Default)]
pub struct OpenOptions {
    /// Its format; recognised from the folder if `None`.
    pub format: Option<Format>,
    /// A calibration file that wins over the folder's own, over presets and over messages.
    pub calibration: Option<PathBuf>,
    /// Depth images, relative to the folder: `depth/%06d.pgm` or `depth_*.png`, with one number or `*` in the last
    /// part. Makes the recording an image folder unless `format` says otherwise.
    pub depth_pattern: Option<String>,
    /// Colour images, likewise. A colour image belongs to the depth image with the same number (or the same text in
    /// place of the `*`).
    pub colour_pattern: Option<String>,
    /// Orientations of an inertial sensor, likewise: `imu/%06d.txt`, a text file a frame with the nine numbers of a 3x3
    /// rotation matrix that takes the sensor's directions to those of a fixed frame. A file belongs to the image with the
    /// same number (or text) in its name; in TUM's format, whose images have no numbers, to the frame in this place, counted from 0. A
    /// frame without a file has no orientation.
    pub imu_pattern: Option<String>,
    /// Which topics of an MCAP file to read, where its messages do not tell.
    pub topics: Topics,
}

/// What is known of a recording before its images are decoded.
#[derive(Clone, Debug)]
pub struct RecordingInfo {
    /// The folder's name, or the file's without its ending.
    pub name: String,
    /// Its format.
    pub format: Format,
    /// Its cameras, for the size of its images.
    pub calibration: Calibration,
    /// Where the calibration came from, in words: `TUM preset fr1, recognised from 'fr1_desk'`.
    pub calibration_source: String,
    /// Number of frames.
    pub frames: usize,
    /// Depth images that are left out because no colour image was taken at nearly the same time.
    pub depth_without_colour: usize,
    /// Whether frames have times of their own; otherwise they are [`nominal_timestamp`]s.
    pub has_timestamps: bool,
    /// Whether there are colour images.
    pub has_colour: bool,
    /// Whether there are a gyroscope's readings.
    pub has_gyroscope: bool,
    /// Whether there are an inertial sensor's orientations.
    pub has_imu_orientation: bool,
    /// All true poses of the depth camera that the recording has, also between frames.
    pub ground_truth: Option<Trajectory>,
}

impl RecordingInfo {
    /// The number of the image that a nominal time stamp stands for, as the recording's files and ground truth count;
    /// `None` for a recording with times of its own. A trajectory of such a recording has it in its time column.
    pub fn image_number(&self, timestamp: Timestamp) -> Option<u64> {
        let number = (i128::from(timestamp.0) * NOMINAL_RATE_HZ + SECOND_NS / 2).div_euclid(SECOND_NS);
        if self.has_timestamps { None } else { u64::try_from(number).ok() }
    }
}

const SECOND_NS: i128 = 1_000_000_000;
/// Rate assumed where a recording has no time stamps.
const NOMINAL_RATE_HZ: i128 = 30;

/// The time given to an image that has none, by its number: 30 images a second from time 0.
pub fn nominal_timestamp(image_number: u32) -> Timestamp {
    // A time column that holds an image number reads as that number of seconds.
    nominal_from_time_column(Timestamp(i64::from(image_number) * 1_000_000_000))
}

/// The nominal time for a time column that holds an image number and was read as seconds.
fn nominal_from_time_column(seconds: Timestamp) -> Timestamp {
    let ns = (i128::from(seconds.0) + NOMINAL_RATE_HZ / 2).div_euclid(NOMINAL_RATE_HZ);
    Timestamp(i64::try_from(ns).expect("a thirtieth of an i64 fits one"))
}

/// A sequence of frames that can be read in any order.
pub trait Recording: Send {
    /// What is known of it.
    fn info(&self) -> &RecordingInfo;

    /// Reads and decodes a frame by its number from 0.
    ///
    /// # Errors
    /// Where this frame cannot be read ([`Error::Frame`], with the file and the reason) or does not exist. Other
    /// frames may still be read.
    fn read(&mut self, index: usize) -> Result<Frame, Error>;

    /// A frame's time, where it is known without decoding the frame.
    fn timestamp(&self, index: usize) -> Option<Timestamp> {
        let _unknown = index;
        None
    }
}

/// Whether a file, by its name or its first bytes, is one that is a recording by itself.
pub fn is_file_of_recording(path: &Path) -> bool {
    path.is_file() && mcap::recognised(path)
}

/// Opens a recording, a folder or an MCAP file, and recognises its format unless `options` name it.
///
/// Images are not decoded yet, but headers are read until one image of each kind is found that will do.
///
/// # Errors
/// Where the folder is missing or of no known format, its lists or calibration cannot be read, or none of its images
/// can be used.
pub fn open(path: &Path, options: &OpenOptions) -> Result<Box<dyn Recording>, Error> {
    let as_mcap = options.format.map_or_else(|| mcap::recognised(path), |format| format == Format::Mcap);
    if path.is_file() && as_mcap {
        return open_mcap(path, None, options);
    }
    let folder = Folder::list(path)?;
    let format = match options.format {
        Some(format) => format,
        None => recognise(&folder, options)?,
    };
    if format != Format::Mcap && !options.topics.is_empty() {
        return Err(Error::NotOfFormat { what: "topics", format: format.name(), of: Format::Mcap.name() });
    }
    let listing = match format {
        Format::Mcap => {
            let file = folder.path.join(the_mcap_file(&folder)?);
            return open_mcap(&file, folder.calibration_file(), options);
        }
        Format::Tum => tum::list(&folder)?,
        Format::IclNuim => icl_nuim::list(&folder)?,
        Format::SevenScenes => seven_scenes::list(&folder)?,
        Format::Images => images::list(&folder, options)?,
    };
    Ok(Box::new(ImageFiles::new(format, listing, options)?))
}

fn open_mcap(path: &Path, calibration: Option<PathBuf>, options: &OpenOptions) -> Result<Box<dyn Recording>, Error> {
    let patterns = [&options.depth_pattern, &options.colour_pattern, &options.imu_pattern];
    if patterns.iter().any(|pattern| pattern.is_some()) {
        return Err(Error::NotOfFormat { what: "patterns of files", format: "mcap", of: "images" });
    }
    Ok(Box::new(mcap::open(path, calibration, options)?))
}

/// The MCAP files in a folder.
fn mcap_files(folder: &Folder) -> Vec<&String> {
    folder.names.iter().filter(|name| name.to_lowercase().ends_with(".mcap") && !name.starts_with('.')).collect()
}

fn the_mcap_file(folder: &Folder) -> Result<&str, Error> {
    match mcap_files(folder).as_slice() {
        [] => Err(Error::NoFiles { path: folder.path.clone(), expected: "file *.mcap".into() }),
        [one] => Ok(one),
        several => Err(Error::SeveralRecordings {
            path: folder.path.clone(),
            names: several.iter().map(ToString::to_string).collect(),
        }),
    }
}

fn recognise(folder: &Folder, options: &OpenOptions) -> Result<Format, Error> {
    if options.depth_pattern.is_some() || options.colour_pattern.is_some() {
        Ok(Format::Images)
    } else if icl_nuim::recognised(folder) {
        Ok(Format::IclNuim)
    } else if seven_scenes::recognised(folder) {
        Ok(Format::SevenScenes)
    } else if tum::recognised(folder) {
        Ok(Format::Tum)
    } else if !mcap_files(folder).is_empty() {
        Ok(Format::Mcap)
    } else if options.calibration.is_some() || folder.calibration_file().is_some() {
        Ok(Format::Images)
    } else {
        let looked_for = "depth.txt and rgb.txt or associations.txt (TUM RGB-D), a *.gt.freiburg file or numbered \
            images in depth/ below a name with 'livingRoom' or 'traj' (ICL-NUIM), frame-000000.depth.png or one folder \
            seq-01 with such (7-Scenes), a file *.mcap (MCAP), calibration.txt or calib.txt beside depth images (image folder)";
        Err(Error::UnknownFormat { path: path_as_shown(&folder.path), looked_for: looked_for.into() })
    }
}

/// Readings since the frame before, for each frame; all in the order of time.
fn readings_by_frame(mut rest: &[AngularRate], stamps: &[Timestamp]) -> Vec<Vec<AngularRate>> {
    let since_the_last = |(position, &time): (usize, &Timestamp)| {
        let readings;
        (readings, rest) = rest.split_at(rest.partition_point(|reading| reading.timestamp <= time));
        // Before the first frame there was none to turn away from: its last reading is the state that it begins in.
        let since = if position == 0 { readings.len().saturating_sub(1) } else { 0 };
        readings[since..].to_vec()
    };
    stamps.iter().enumerate().map(since_the_last).collect()
}

fn path_as_shown(path: &Path) -> PathBuf {
    // The empty path, as of a pattern without a folder, is the current folder.
    if path.as_os_str().is_empty() { PathBuf::from(".") } else { path.to_path_buf() }
}

/// A folder and the names in it.
#[derive(Clone)]
struct Folder {
    path: PathBuf,
    /// Sorted. Names that are not Unicode are left out: nothing here could match them.
    names: Vec<String>,
}

impl Folder {
    fn list(path: &Path) -> Result<Self, Error> {
        let path = path_as_shown(path);
        let metadata = path.metadata().map_err(|reason| match reason.kind() {
            ErrorKind::NotFound => Error::NotFound { path: path.clone() },
            _ => Error::io("open", &path, reason),
        })?;
        if !metadata.is_dir() {
            return Err(Error::NotAFolder { path });
        }
        let mut names = Vec::new();
        for entry in path.read_dir().map_err(|reason| Error::io("list", &path, reason))? {
            let entry = entry.map_err(|reason| Error::io("list", &path, reason))?;
            names.extend(entry.file_name().into_string());
        }
        names.sort();
        Ok(Self { path, names })
    }

    fn has(&self, name: &str) -> bool {
        self.names.binary_search_by(|n| n.as_str().cmp(name)).is_ok()
    }

    /// The file's path, if there is such a file.
    fn file(&self, name: &str) -> Option<PathBuf> {
        self.has(name).then(|| self.path.join(name))
    }

    fn calibration_file(&self) -> Option<PathBuf> {
        ["calibration.txt", "calib.txt"].into_iter().find_map(|name| self.file(name))
    }

    /// The names of the folder and of those that it lies in, the deepest first: as given, then as they are on disk.
    fn path_parts(&self) -> Vec<String> {
        let parts = |path: &Path| -> Vec<String> {
            path.components().rev().map(|part| part.as_os_str().to_string_lossy().into_owned()).collect()
        };
        let mut names = parts(&self.path);
        // A folder that has just been listed can be resolved, or else its parts as given must do.
        names.extend(self.path.canonicalize().iter().flat_map(|path| parts(path)));
        names
    }
}

/// What a format's module finds in a folder.
struct Listing {
    /// The folder with the images, which may lie below the one that was opened.
    folder: Folder,
    frames: Vec<FrameFiles>,
    preset: Option<Preset>,
    depth_without_colour: usize,
    has_timestamps: bool,
    has_gyroscope: bool,
    ground_truth: Option<Trajectory>,
}

/// The files of a frame.
#[derive(Debug)]
struct FrameFiles {
    depth: PathBuf,
    colour: Option<PathBuf>,
    timestamp: Timestamp,
    /// Of the colour image, where it has one of its own.
    colour_timestamp: Option<Timestamp>,
    world_from_camera: Option<Se3>,
    /// By which other files belong to it.
    key: Key,
    gyroscope: Vec<AngularRate>,
    imu: Option<PathBuf>,
}

impl FrameFiles {
    /// A frame of which nothing but depth is known.
    fn new(depth: PathBuf, timestamp: Timestamp, key: Key) -> Self {
        Self {
            depth,
            colour: None,
            timestamp,
            colour_timestamp: None,
            world_from_camera: None,
            key,
            gyroscope: Vec::new(),
            imu: None,
        }
    }
}

/// Cameras known from the format.
struct Preset {
    calibration: Calibration,
    /// In words.
    source: String,
}

/// A recording whose frames are image files: all formats but MCAP.
struct ImageFiles {
    info: RecordingInfo,
    frames: Vec<FrameFiles>,
}

impl ImageFiles {
    fn new(format: Format, listing: Listing, options: &OpenOptions) -> Result<Self, Error> {
        let Listing { folder, mut frames, preset, depth_without_colour, has_timestamps, has_gyroscope, ground_truth } =
            listing;
        if let Some(pattern) = &options.imu_pattern {
            find_orientations(&folder, pattern, &mut frames)?;
        }
        let depth_images = || frames.iter().map(|frame| frame.depth.as_path());
        let colour_images = || frames.iter().filter_map(|frame| frame.colour.as_deref());
        let has_colour = colour_images().next().is_some();

        let file = options.calibration.clone().or_else(|| folder.calibration_file());
        let (calibration, calibration_source) = match (file, preset) {
            (Some(file), _) => {
                let calibration = calibration::read(&file)?;
                let (depth, colour) = (&calibration.depth, &calibration.colour);
                decode::find_usable(decode::Kind::Depth, depth_images(), Some((depth.width, depth.height)))?;
                if has_colour {
                    decode::find_usable(decode::Kind::Colour, colour_images(), Some((colour.width, colour.height)))?;
                }
                (calibration, format!("calibration file '{}'", file.display()))
            }
            (None, Some(preset)) => {
                let depth = decode::find_usable(decode::Kind::Depth, depth_images(), None)?;
                let colour =
                    if has_colour { decode::find_usable(decode::Kind::Colour, colour_images(), None)? } else { depth };
                preset.for_sizes(depth, colour)
            }
            (None, None) => return Err(Error::NoCalibration { path: folder.path }),
        };
        if depth_without_colour > 0 {
            tracing::warn!(
                "{depth_without_colour} depth images of '{}' have no colour image close in time and are left out",
                folder.path.display()
            );
        }
        let name = folder.path.canonicalize().ok().and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned()));
        let info = RecordingInfo {
            name: name.unwrap_or_else(|| folder.path.display().to_string()),
            format,
            calibration,
            calibration_source,
            frames: frames.len(),
            depth_without_colour,
            has_timestamps,
            has_colour,
            has_gyroscope,
            has_imu_orientation: options.imu_pattern.is_some(),
            ground_truth,
        };
        Ok(Self { info, frames })
    }
}

/// Gives each frame its file with an inertial sensor's orientation.
fn find_orientations(folder: &Folder, given: &str, frames: &mut [FrameFiles]) -> Result<(), Error> {
    let pattern = Pattern::parse(&folder.path, given)?;
    let files = pattern.files()?;
    for frame in &mut *frames {
        let same_number = || files.get(&frame.key.number()?);
        frame.imu = files.get(&frame.key).or_else(same_number).map(|varying| pattern.path(varying));
    }
    let missing = frames.iter().filter(|frame| frame.imu.is_none()).count();
    if missing == frames.len() {
        let expected =
            format!("rotation files named as '{given}' with the images' numbers ({} with others)", files.len());
        return Err(Error::NoFiles { path: folder.path.clone(), expected });
    }
    if missing > 0 {
        tracing::warn!("{missing} of {} frames have no orientation '{}'", frames.len(), pattern.given);
    }
    Ok(())
}

impl Preset {
    /// The preset for images of other sizes than its own.
    fn for_sizes(self, depth: (u32, u32), colour: (u32, u32)) -> (Calibration, String) {
        let Self { calibration: preset, source } = self;
        let calibration = Calibration {
            depth: preset.depth.scaled_to(depth.0, depth.1),
            colour: preset.colour.scaled_to(colour.0, colour.1),
            ..preset
        };
        // An unscaled preset keeps its published digits.
        let unscaled = |c: &itm_core::Intrinsics, size| (c.width, c.height) == size;
        if unscaled(&preset.depth, depth) && unscaled(&preset.colour, colour) {
            return (preset, source);
        }
        let own = (preset.depth.width, preset.depth.height);
        (calibration, format!("{source}; scaled from {}x{} to the images' size", own.0, own.1))
    }
}

impl Recording for ImageFiles {
    fn info(&self) -> &RecordingInfo {
        &self.info
    }

    fn read(&mut self, index: usize) -> Result<Frame, Error> {
        let files = self.frames.get(index).ok_or(Error::NoSuchFrame { index, frames: self.frames.len() })?;
        let Calibration { depth, colour, .. } = &self.info.calibration;
        let images = || {
            let colour_size = (colour.width, colour.height);
            Ok((
                decode::depth(&files.depth, (depth.width, depth.height))?,
                files.colour.as_deref().map(|path| decode::colour(path, colour_size)).transpose()?,
                files.imu.as_deref().map(matrix::read_rotation).transpose()?,
            ))
        };
        let (depth, colour, imu_orientation) =
            images().map_err(|reason| Error::Frame { index, reason: Box::new(reason) })?;
        Ok(Frame {
            colour_timestamp: files.colour_timestamp,
            world_from_camera: files.world_from_camera,
            gyroscope: files.gyroscope.clone(),
            imu_orientation,
            ..Frame::new(index as u64, files.timestamp, DepthImage::Raw(depth), colour)
        })
    }

    fn timestamp(&self, index: usize) -> Option<Timestamp> {
        Some(self.frames.get(index)?.timestamp)
    }
}
