//! What can go wrong with a file.

use std::path::{Path, PathBuf};

use itm_core::{CalibrationError, GeometryError};
use thiserror::Error;

/// Why a file could not be read or written: what was expected, what was found, and where.
///
/// Each message is a whole sentence that already holds its cause, so there is no chain of sources to print behind it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused to open, read, list or write something.
    #[error("cannot {action} '{}': {reason}", path.display())]
    Io {
        /// What was tried: `open`, `read`, `list`, `write`.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// The operating system's reason.
        reason: std::io::Error,
    },
    /// A line of a text file that is not of its format.
    #[error("'{}', line {line}: expected {expected}, found {found}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What would do.
        expected: String,
        /// What stands there.
        found: String,
    },
    /// A calibration file whose numbers cannot be meant.
    #[error("'{}': {reason}", path.display())]
    Calibration {
        /// The file.
        path: PathBuf,
        /// Which number, and why.
        reason: CalibrationError,
    },

    /// A recording's path that is not there.
    #[error("'{}' does not exist", path.display())]
    NotFound {
        /// The path as given.
        path: PathBuf,
    },
    /// A recording's path that is a file, and not one that is a recording by itself.
    #[error("'{}' is a file; a recording is a folder, or a file in the format MCAP", path.display())]
    NotAFolder {
        /// The path as given.
        path: PathBuf,
    },
    /// A folder in which no format of recording was recognised.
    #[error("'{}' is of no known format; looked for {looked_for}", path.display())]
    UnknownFormat {
        /// The folder.
        path: PathBuf,
        /// What would have been recognised.
        looked_for: String,
    },
    /// A folder that holds several recordings where one is needed.
    #[error("'{}' holds several recordings ({}); name one of them", path.display(), names.join(", "))]
    SeveralRecordings {
        /// The folder.
        path: PathBuf,
        /// The recordings' names within it.
        names: Vec<String>,
    },
    /// A format's name that is none of the known ones.
    #[error("'{given}' is no known format of recordings; there are {known}")]
    FormatName {
        /// As given.
        given: String,
        /// The known ones.
        known: String,
    },
    /// A recording without a single frame.
    #[error("'{}' has no frames: expected {expected}", path.display())]
    NoFrames {
        /// The folder or list.
        path: PathBuf,
        /// What would have been a frame.
        expected: String,
    },
    /// No depth image was taken close enough in time to a colour image.
    #[error(
        "none of the {depth_images} depth images in '{}' has a colour image in '{}' ({colour_images} images) within {tolerance_ms} ms; the closest two are {closest_s} s apart",
        depth_list.display(), colour_list.display()
    )]
    NoAssociation {
        /// The list of depth images.
        depth_list: PathBuf,
        /// Its length.
        depth_images: usize,
        /// The list of colour images.
        colour_list: PathBuf,
        /// Its length.
        colour_images: usize,
        /// Largest distance in time, in milliseconds.
        tolerance_ms: i64,
        /// Smallest distance in time that there is, in seconds.
        closest_s: f64,
    },
    /// A recording whose cameras are known neither from a file nor from its format.
    #[error(
        "the cameras of '{}' are not known: put a calibration file there (calibration.txt or calib.txt), or name one",
        path.display()
    )]
    NoCalibration {
        /// The recording.
        path: PathBuf,
    },
    /// Files that were asked for beside a recording's images, of which not one is there.
    #[error("'{}' holds no {expected}", path.display())]
    NoFiles {
        /// The folder.
        path: PathBuf,
        /// What would have been one.
        expected: String,
    },
    /// A pattern for files that cannot be followed.
    #[error("the pattern '{pattern}' must have {expected}")]
    Pattern {
        /// As given.
        pattern: String,
        /// What would do.
        expected: &'static str,
    },

    /// What one format has no use for.
    #[error("{what} are of recordings in the format {of}; this one is {format}")]
    NotOfFormat {
        /// What was asked for.
        what: &'static str,
        /// The recording's format.
        format: &'static str,
        /// The format that it would have been of use for.
        of: &'static str,
    },
    /// A file that cannot be read as MCAP.
    #[error("cannot read '{}' as MCAP: {reason}", path.display())]
    Mcap {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and where.
        reason: String,
    },
    /// An MCAP file in which no topic fits, or several do.
    #[error("'{}': {problem}{}{advice}", path.display(), as_lines(candidates))]
    Topics {
        /// The file.
        path: PathBuf,
        /// What is missing, or not clear.
        problem: String,
        /// Topics that there are, each with its schema and number of messages.
        candidates: Vec<String>,
        /// How to choose, or what would do.
        advice: String,
    },
    /// A choice of topics that cannot be understood.
    #[error("the choice of a topic '{given}' is not understood: expected {expected}")]
    TopicChoice {
        /// As given.
        given: String,
        /// What would do.
        expected: &'static str,
    },
    /// A topic of an MCAP file whose messages cannot be used.
    #[error("'{}', topic '{topic}': {reason}", path.display())]
    McapTopic {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Why not.
        reason: String,
    },
    /// A message of an MCAP file that cannot be used.
    #[error("'{}', topic '{topic}', message {message}: {reason}", path.display())]
    Message {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The message's number within its topic, from 0, in the order in which they lie in the file.
        message: usize,
        /// Why not.
        reason: String,
    },

    /// An image file that is cut off or damaged, or of a format that is not read here.
    #[error("cannot decode '{}': {reason}", path.display())]
    Decode {
        /// The image file.
        path: PathBuf,
        /// The decoder's reason.
        reason: String,
    },
    /// An image whose pixels are of another kind than expected.
    #[error("'{}': expected {expected}, found {found}", path.display())]
    PixelFormat {
        /// The image file.
        path: PathBuf,
        /// What would do.
        expected: &'static str,
        /// What its pixels are.
        found: String,
    },
    /// An image of another size than the calibration says.
    #[error(
        "'{}': expected an image of {}x{} pixels as in the calibration, found {}x{}",
        path.display(), expected.0, expected.1, found.0, found.1
    )]
    ImageSize {
        /// The image file.
        path: PathBuf,
        /// Width and height of the calibration's camera.
        expected: (u32, u32),
        /// The image's own width and height.
        found: (u32, u32),
    },
    /// One frame of a recording could not be read; others may be.
    #[error("frame {index}: {reason}")]
    Frame {
        /// The frame's number within the recording, from 0.
        index: usize,
        /// What went wrong.
        reason: Box<Error>,
    },
    /// A frame beyond the end of a recording.
    #[error("frame {index} was asked for, but the recording has {frames} frames")]
    NoSuchFrame {
        /// The number asked for, from 0.
        index: usize,
        /// Number of frames in the recording.
        frames: usize,
    },

    /// A pose with numbers that are infinite or not numbers, which no trajectory file may hold.
    #[error("the pose of frame {frame} is not finite and was not written to '{}'", path.display())]
    PoseNotFinite {
        /// The trajectory file.
        path: PathBuf,
        /// The frame's number within its recording.
        frame: u64,
    },
    /// A name for a mesh or point cloud file whose extension is none of the formats that can be written.
    #[error(
        "cannot tell the {what} format of '{}' from its name: expected it to end in {known}",
        path.display()
    )]
    ExportFormat {
        /// The path as given.
        path: PathBuf,
        /// What was to be written: `mesh` or `point cloud`.
        what: &'static str,
        /// The known extensions.
        known: &'static str,
    },
    /// A mesh or point cloud that no file can hold.
    #[error("cannot write '{}': {reason}", path.display())]
    Geometry {
        /// The file.
        path: PathBuf,
        /// What does not fit together.
        reason: GeometryError,
    },

    /// A file that does not begin as a PLY file does.
    #[error("'{}' is not a PLY file: it does not begin with the line 'ply'", path.display())]
    NotAPly {
        /// The file.
        path: PathBuf,
    },
    /// A PLY file whose end is missing, as of a copy that was interrupted.
    #[error("'{}' is cut off: it ends within {within}", path.display())]
    PlyCutOff {
        /// The file.
        path: PathBuf,
        /// What would have gone on.
        within: String,
    },
    /// A PLY file that holds something else than it should.
    #[error("'{}', {place}: expected {expected}, found {found}", path.display())]
    PlyContent {
        /// The file.
        path: PathBuf,
        /// Its header, or which vertex or face.
        place: String,
        /// What would do.
        expected: String,
        /// What it holds.
        found: String,
    },

    /// A file that does not begin as a map file does.
    #[error("'{}' is not a map file of itm", path.display())]
    NotAMap {
        /// The file.
        path: PathBuf,
    },
    /// A map file of a later version of the format.
    #[error(
        "'{}' is a map file of format {}.{}; this program reads up to {}.{}: a later one is needed",
        path.display(), found.0, found.1, supported.0, supported.1
    )]
    MapVersion {
        /// The map file.
        path: PathBuf,
        /// Its format's major and minor version.
        found: (u16, u16),
        /// The latest that can be read.
        supported: (u16, u16),
    },
    /// A map file whose end is missing, as of a copy that was interrupted.
    #[error("'{}' is cut off: it ends after {length} bytes, within {within}", path.display())]
    MapCutOff {
        /// The map file.
        path: PathBuf,
        /// Bytes that are there.
        length: u64,
        /// What would have gone on.
        within: String,
    },
    /// A map file whose bytes are not those that were written.
    #[error("'{}' is damaged in {place}: {problem}", path.display())]
    MapDamaged {
        /// The map file.
        path: PathBuf,
        /// Which section, or what else.
        place: String,
        /// How that shows.
        problem: String,
    },
    /// A map file, whole and undamaged, that holds something else than it should, or a map that no file can hold.
    #[error("'{}', {place}: expected {expected}, found {found}", path.display())]
    MapContent {
        /// The map file.
        path: PathBuf,
        /// Which section.
        place: String,
        /// What would do.
        expected: String,
        /// What it holds.
        found: String,
    },
    /// A section that a map file does not have.
    #[error("'{}' has no {section}", path.display())]
    NoMapSection {
        /// The map file.
        path: PathBuf,
        /// Which one.
        section: String,
    },
}

/// A list between two texts, with a line for each.
fn as_lines(items: &[String]) -> String {
    if items.is_empty() { "; ".into() } else { format!(":\n  {}\n", items.join("\n  ")) }
}

impl Error {
    pub(crate) fn io(action: &'static str, path: &Path, reason: std::io::Error) -> Self {
        Self::Io { action, path: path.to_path_buf(), reason }
    }

    pub(crate) fn export_format(path: &Path, what: &'static str, known: &'static str) -> Self {
        Self::ExportFormat { path: path.to_path_buf(), what, known }
    }

    pub(crate) fn line(path: &Path, line: usize, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Line { path: path.to_path_buf(), line, expected: expected.into(), found: found.into() }
    }
}
