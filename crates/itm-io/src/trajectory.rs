//! Trajectories in the format of the TUM RGB-D benchmark (Sturm et al. 2012): a row for each pose,
//! `timestamp tx ty tz qx qy qz qw`, that holds the camera's pose in the world: metres, and a unit quaternion.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use itm_core::{PoseError, Se3, StampedPose, Timestamp, Trajectory};

use crate::recording::{Pattern, Varying};
use crate::{Error, matrix, text};

const ROW: &str = "timestamp tx ty tz qx qy qz qw";

/// Reads a trajectory. Blank lines and comments (`#`) are passed over, rows may be in any order.
///
/// Time stamps are decimal seconds and keep every digit down to the nanosecond. A file whose first column holds frame
/// numbers reads as if each were so many seconds: exact, and to be compared with a file of the same kind only.
///
/// # Errors
/// Where the file cannot be read, or a row is not eight numbers, holds numbers that are not finite, or a quaternion
/// whose length is more than 1 % away from one; the error names the line.
pub fn read_tum(path: &Path) -> Result<Trajectory, Error> {
    parse_tum(&text::read(path)?, path)
}

fn parse_tum(text: &str, path: &Path) -> Result<Trajectory, Error> {
    text::data_lines(text)
        .map(|(line, row)| {
            let fields: Vec<&str> = row.split_whitespace().collect();
            let Ok([time, numbers @ ..]) = <[&str; 8]>::try_from(fields.as_slice()) else {
                let found = format!("{} values: {}", fields.len(), text::quoted(row));
                return Err(Error::line(path, line, format!("eight values '{ROW}'"), found));
            };
            let timestamp = text::parse_seconds(time)
                .ok_or_else(|| Error::line(path, line, "a time stamp in decimal seconds", text::quoted(time)))?;
            let mut values = [0.0; 7];
            for (value, word) in values.iter_mut().zip(numbers) {
                *value = word.parse().map_err(|_| Error::line(path, line, "a number", text::quoted(word)))?;
            }
            let [tx, ty, tz, qx, qy, qz, qw] = values;
            let (rotation, translation) = (DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(tx, ty, tz));
            let world_from_camera = Se3::try_from_quaternion(rotation, translation).map_err(|reason| {
                let expected = match reason {
                    PoseError::NotFinite => "finite numbers",
                    _ => "a quaternion of unit length",
                };
                Error::line(path, line, expected, text::quoted(row))
            })?;
            Ok(StampedPose { timestamp, world_from_camera })
        })
        .collect()
}

/// Poses that a recording's frames are looked up in: a file each, or one trajectory.
///
/// ```no_run
/// use itm_core::Timestamp;
/// use itm_io::trajectory::PoseFiles;
///
/// let poses = PoseFiles::new("scan".as_ref(), "poses/%06d.txt")?;
/// if let Some(world_from_camera) = poses.read(17, Timestamp(0))? {
///     println!("{}", world_from_camera.translation);
/// }
/// # Ok::<(), itm_io::Error>(())
/// ```
#[derive(Debug)]
pub struct PoseFiles(Source);

#[derive(Debug)]
enum Source {
    Matrices(Pattern),
    Trajectory {
        poses: Trajectory,
        /// Whether its first column counts frames rather than seconds: every entry is a whole number.
        numbered: bool,
    },
}

const SECOND_NS: i64 = 1_000_000_000;
/// Largest distance in time between a frame and its pose in a trajectory.
const TOLERANCE_NS: i64 = 20_000_000;

impl PoseFiles {
    /// Poses by what they are given as, relative to a folder: a mask for files that hold a matrix each, with the frame's
    /// number in its last part (`poses/%06d.txt`), or, where there is no `%` in it, a trajectory in TUM's format.
    ///
    /// # Errors
    /// Where a mask has anything but one number, or no file is of its form; where a trajectory cannot be read (as
    /// [`read_tum`]).
    pub fn new(folder: &Path, given: &str) -> Result<Self, Error> {
        if !given.contains(['%', '*']) {
            let poses = read_tum(&folder.join(given))?;
            let numbered = poses.poses().iter().all(|p| p.timestamp.0 % SECOND_NS == 0);
            return Ok(Self(Source::Trajectory { poses, numbered }));
        }
        let pattern = Pattern::parse(folder, given)?;
        if pattern.varying == Varying::Text {
            return Err(Error::Pattern {
                pattern: given.into(),
                expected: "a number such as %06d, for the frame's number",
            });
        }
        if pattern.files()?.is_empty() {
            return Err(Error::NoFiles { path: pattern.folder, expected: format!("pose files named as '{given}'") });
        }
        Ok(Self(Source::Matrices(pattern)))
    }

    /// Whether frames find their poses by time, rather than by number.
    pub fn is_by_time(&self) -> bool {
        matches!(self.0, Source::Trajectory { numbered: false, .. })
    }

    /// The pose of a frame, `world_from_camera`: from the file with its number, which holds 16 or 12 numbers, a 4x4 matrix
    /// from camera to world or its upper three rows; or from the trajectory, where the pose nearest to its time within 20 ms
    /// counts. A trajectory whose first column holds whole numbers only, as for recordings without times, counts frames there.
    ///
    /// `None` where there is no such file or pose.
    ///
    /// # Errors
    /// Where a file cannot be read, or what it holds is no rigid motion of finite numbers; the error names file and line.
    pub fn read(&self, number: u64, timestamp: Timestamp) -> Result<Option<Se3>, Error> {
        match &self.0 {
            Source::Matrices(pattern) => {
                let path = pattern.path_expected(&number.to_string());
                match path.try_exists() {
                    Ok(true) => matrix::read_pose(&path).map(Some),
                    Ok(false) => Ok(None),
                    Err(reason) => Err(Error::io("open", &path, reason)),
                }
            }
            Source::Trajectory { poses, numbered } => {
                let pose = if *numbered {
                    // A frame number reads as so many seconds.
                    let time = i64::try_from(number).ok().and_then(|n| n.checked_mul(SECOND_NS));
                    time.and_then(|ns| poses.nearest(Timestamp(ns), 0))
                } else {
                    poses.nearest(timestamp, TOLERANCE_NS)
                };
                Ok(pose.map(|pose| pose.world_from_camera))
            }
        }
    }
}

/// What the first column of a trajectory file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeColumn {
    /// Seconds with nine decimals: every nanosecond of the time stamps.
    Seconds,
    /// The frame's number within its recording: for recordings without time stamps, whose ground truth is numbered
    /// likewise.
    FrameNumber,
}

/// Writes a trajectory row by row, each handed to the operating system before [`TumWriter::write`] returns, so that a
/// program that crashes loses none.
#[derive(Debug)]
pub struct TumWriter {
    file: File,
    path: PathBuf,
    time: TimeColumn,
    row: String,
    /// Bytes of the rows written so far.
    whole_rows: u64,
}

impl TumWriter {
    /// Creates the file, or empties the one that is there, and writes a comment that names the columns.
    ///
    /// # Errors
    /// Where the file cannot be created or written.
    pub fn create(path: &Path, time: TimeColumn) -> Result<Self, Error> {
        let file = File::create(path).map_err(|e| Error::io("create", path, e))?;
        let mut writer = Self { file, path: path.to_path_buf(), time, row: String::new(), whole_rows: 0 };
        writer.row.push_str(match time {
            TimeColumn::Seconds => "# timestamp tx ty tz qx qy qz qw\n",
            TimeColumn::FrameNumber => "# frame tx ty tz qx qy qz qw\n",
        });
        writer.write_row()?;
        Ok(writer)
    }

    /// Writes one pose: that of frame number `frame` of the recording. Of a quaternion and its negative, which are the
    /// same rotation, the one with `qw >= 0` is written; numbers have as many digits as they need to read back the
    /// same.
    ///
    /// # Errors
    /// Where the pose is not finite (nothing is written then) or the file cannot be written.
    pub fn write(&mut self, frame: u64, pose: &StampedPose) -> Result<(), Error> {
        let Se3 { rotation: q, translation: t } = pose.world_from_camera;
        if !pose.world_from_camera.is_finite() {
            return Err(Error::PoseNotFinite { path: self.path.clone(), frame });
        }
        let q = if q.w < 0.0 { -q } else { q };
        self.row.clear();
        let written = match self.time {
            TimeColumn::Seconds => write!(self.row, "{}", pose.timestamp),
            TimeColumn::FrameNumber => write!(self.row, "{frame}"),
        }
        .and_then(|()| {
            // Debug, unlike Display, prints tiny numbers with an exponent. Adding zero turns -0 to 0.
            [t.x, t.y, t.z, q.x, q.y, q.z, q.w].iter().try_for_each(|v| write!(self.row, " {:?}", v + 0.0))
        });
        written.expect("a String takes whatever is written to it");
        self.row.push('\n');
        self.write_row()
    }

    /// One call for the whole row, so that no half row stays behind.
    fn write_row(&mut self) -> Result<(), Error> {
        let written = self.file.write_all(self.row.as_bytes());
        if written.is_err() {
            // A full disk may have taken the row's first bytes. Where even that can't be undone, the first error tells.
            let _ = self.file.set_len(self.whole_rows);
        } else {
            self.whole_rows += self.row.len() as u64;
        }
        written.map_err(|e| Error::io("write", &self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use itm_core::Timestamp;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Trajectory, String> {
        parse_tum(text, Path::new("t.txt")).map_err(|e| e.to_string())
    }

    fn write_and_read(time: TimeColumn, poses: &[(u64, StampedPose)]) -> (String, Trajectory) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.txt");
        let mut writer = TumWriter::create(&path, time).unwrap();
        for (frame, pose) in poses {
            writer.write(*frame, pose).unwrap();
        }
        // The writer still lives: nothing waits in a buffer.
        let text = std::fs::read_to_string(&path).unwrap();
        (text, read_tum(&path).unwrap())
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back(
            ns: i64, t in prop::array::uniform3(-1e4..1e4f64), w in prop::array::uniform3(-3.0..3.0f64),
        ) {
            let world_from_camera = Se3::exp([t[0], t[1], t[2], w[0], w[1], w[2]]);
            let pose = StampedPose { timestamp: Timestamp(ns), world_from_camera };
            let (_, read) = write_and_read(TimeColumn::Seconds, &[(0, pose)]);
            let back = read.poses()[0];
            prop_assert_eq!(back.timestamp, pose.timestamp);
            prop_assert_eq!(back.world_from_camera.translation, world_from_camera.translation);
            // Only the last digit may change: readers normalise.
            let sign = if world_from_camera.rotation.w < 0.0 { -1.0 } else { 1.0 };
            prop_assert!(back.world_from_camera.rotation.abs_diff_eq(world_from_camera.rotation * sign, 1e-15));
        }
    }

    #[test]
    fn rows_have_one_form() {
        let rotation = DQuat::from_xyzw(0.0, -0.6, 0.0, -0.8);
        let pose = StampedPose {
            timestamp: Timestamp(1_305_031_229_528_748_000),
            world_from_camera: Se3 { rotation, translation: DVec3::new(-0.0, 1e-20, 0.1) },
        };
        let row = " 0.0 1e-20 0.1 0.0 0.6 0.0 0.8\n";
        let (text, _) = write_and_read(TimeColumn::Seconds, &[(7, pose)]);
        assert_eq!(text, format!("# timestamp tx ty tz qx qy qz qw\n1305031229.528748000{row}"));
        let (text, read) = write_and_read(TimeColumn::FrameNumber, &[(7, pose)]);
        assert_eq!(text, format!("# frame tx ty tz qx qy qz qw\n7{row}"));
        assert_eq!(read.poses()[0].timestamp, Timestamp(7_000_000_000));
    }

    #[test]
    fn files_of_others_are_read() {
        let text = "# ground truth\r\n\r\n1305031229.5287\t1 2 3 0 0 0 1\r\n1.3050312290e+09 0 0 0 0 0 0 -1.005\r\n";
        let poses = parse(text).unwrap().poses().to_vec();
        assert_eq!(poses[0].timestamp, Timestamp(1_305_031_229_000_000_000));
        assert_eq!(poses[0].world_from_camera.angle(), 0.0);
        assert_eq!(poses[1].timestamp, Timestamp(1_305_031_229_528_700_000));
        assert_eq!(poses[1].world_from_camera.translation, DVec3::new(1.0, 2.0, 3.0));
        assert!(parse("# no pose yet\n").unwrap().is_empty());
    }

    #[test]
    fn frames_find_their_poses_in_files_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let poses = folder.path().join("poses");
        std::fs::create_dir(&poses).unwrap();
        let error = PoseFiles::new(folder.path(), "poses/%04d.txt").unwrap_err().to_string();
        assert!(error.ends_with("poses' holds no pose files named as 'poses/%04d.txt'"), "{error}");
        std::fs::write(poses.join("0007.txt"), "0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n").unwrap();
        std::fs::write(poses.join("0008.txt"), "1 0 0 0\n0 1 0 nan\n0 0 1 0\n").unwrap();
        let files = PoseFiles::new(folder.path(), "poses/%04d.txt").unwrap();
        let pose = files.read(7, Timestamp(0)).unwrap().unwrap();
        assert_eq!(pose.translation, DVec3::new(1.0, 2.0, 3.0));
        assert!(pose.transform_vector(DVec3::X).abs_diff_eq(DVec3::Y, 1e-12), "camera to world");
        assert_eq!(files.read(9, Timestamp(0)).unwrap(), None);
        let error = files.read(8, Timestamp(0)).unwrap_err().to_string();
        assert!(error.contains("0008.txt', line 2") && error.contains("'nan'"), "{error}");

        let error = PoseFiles::new(folder.path(), "poses/*.txt").unwrap_err().to_string();
        assert!(error.contains("must have a number such as %06d"), "{error}");
        assert!(PoseFiles::new(folder.path(), "nowhere/%d.txt").is_err());
        assert!(PoseFiles::new(folder.path(), "poses/%d_%d.txt").is_err());
    }

    #[test]
    fn frames_find_their_poses_in_a_trajectory() {
        let folder = tempfile::tempdir().unwrap();
        let rows = "# poses\n5 1 0 0 0 0 0 1\n6 2 0 0 0 0 0 1\n6.03 3 0 0 0 0 0 1\n";
        std::fs::write(folder.path().join("t.txt"), rows).unwrap();
        let poses = PoseFiles::new(folder.path(), "t.txt").unwrap();
        assert!(poses.is_by_time());
        let x = |poses: &PoseFiles, number, ms: i64| {
            poses.read(number, Timestamp(ms * 1_000_000)).unwrap().map(|pose| pose.translation.x)
        };
        assert_eq!((x(&poses, 0, 6_012), x(&poses, 0, 6_016), x(&poses, 5, 6_049)), (Some(2.0), Some(3.0), Some(3.0)));
        assert_eq!(x(&poses, 5, 5_021), None, "farther than 20 ms");
        // Whole numbers are those of frames, as in the trajectory of a recording without times.
        std::fs::write(folder.path().join("n.txt"), "5 1 0 0 0 0 0 1\n6 2 0 0 0 0 0 1\n").unwrap();
        let poses = PoseFiles::new(folder.path(), "n.txt").unwrap();
        assert!(!poses.is_by_time());
        assert_eq!([5, 6, 7, u64::MAX].map(|n| x(&poses, n, 5_000)), [Some(1.0), Some(2.0), None, None]);
        assert!(PoseFiles::new(folder.path(), "none.txt").is_err());
    }

    #[test]
    fn bad_rows_are_refused_with_their_line() {
        for (row, expected) in [
            ("1 0 0 0 0 0 0", "found 7 values"),
            ("1 0 0 0 0 0 0 1 0", "found 9 values"),
            ("one 0 0 0 0 0 0 1", "a time stamp in decimal seconds"),
            ("1 0 0 0,5 0 0 0 1", "expected a number, found '0,5'"),
            ("1 nan 0 0 0 0 0 1", "finite numbers"),
            ("1 0 0 0 0 inf 0 1", "finite numbers"),
            ("1 0 0 0 0 0 0 0.98", "unit length"),
            ("1 0 0 0 0 0 0 0", "unit length"),
        ] {
            let error = parse(&format!("# comment\n0 0 0 0 0 0 0 1\n{row}\n")).unwrap_err();
            assert!(error.contains("'t.txt', line 3") && error.contains(expected), "{error}");
        }
    }

    #[test]
    fn poses_that_are_not_finite_are_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.txt");
        let mut writer = TumWriter::create(&path, TimeColumn::Seconds).unwrap();
        let world_from_camera = Se3 { translation: DVec3::NAN, ..Se3::IDENTITY };
        let error = writer.write(12, &StampedPose { timestamp: Timestamp(0), world_from_camera }).unwrap_err();
        assert!(error.to_string().contains("frame 12"), "{error}");
        assert!(read_tum(&path).unwrap().is_empty());
    }

    #[test]
    fn files_that_cannot_be_opened_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no such folder").join("trajectory.txt");
        let read = read_tum(&path).unwrap_err().to_string();
        let created = TumWriter::create(&path, TimeColumn::Seconds).unwrap_err().to_string();
        assert!(read.contains("no such folder") && created.contains("cannot create"), "{read}; {created}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error() {
        let error = TumWriter::create(Path::new("/dev/full"), TimeColumn::Seconds).unwrap_err().to_string();
        assert!(error.contains("cannot write '/dev/full'"), "{error}");
    }

    #[test]
    fn ground_truth_of_real_recordings_is_read() {
        let Some(folder) = std::env::var_os("ITM_TEST_DATA").map(PathBuf::from) else {
            eprintln!("skipped: ITM_TEST_DATA is not set");
            return;
        };
        for (name, first) in [
            ("tum_fr1_rpy_head/groundtruth.txt", 1_305_031_225_933_400_000),
            ("icl_lr_kt2_head/livingRoom2.gt.freiburg", 1_000_000_000),
        ] {
            let truth = read_tum(&folder.join(name)).unwrap();
            assert_eq!(truth.poses()[0].timestamp, Timestamp(first));
            let e = itm_core::evaluation::evaluate(&truth, &truth, 0).unwrap();
            assert_eq!(e.pairs, truth.len());
            // Hand-held, and never further from itself than rounding.
            assert!(e.path_length_m > 0.1 && e.ate.max < 1e-9 && e.rpe_rotation.max < 1e-7, "{e}");
        }
    }
}
