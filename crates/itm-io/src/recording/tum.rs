//! TUM RGB-D: lists of depth and colour images with time stamps (Sturm et al. 2012, *A Benchmark for the Evaluation of
//! RGB-D SLAM Systems*).

use std::path::{Path, PathBuf};

use glam::DVec3;
use itm_core::{AngularRate, Calibration, DepthConversion, Distortion, Intrinsics, Timestamp};

use super::images::Key;
use super::{Folder, FrameFiles, Listing, Preset, decode, readings_by_frame};
use crate::{Error, text, trajectory};

/// Largest distance in time between a depth image and what belongs to it: colour, true pose.
const TOLERANCE_MS: i64 = 20;
const TOLERANCE_NS: i64 = TOLERANCE_MS * 1_000_000;

const DEPTH_LIST: &str = "depth.txt";
const COLOUR_LIST: &str = "rgb.txt";
const GYROSCOPE: &str = "gyroscope.txt";
const ASSOCIATIONS: [&str; 5] = ["associations.txt", "association.txt", "associated.txt", "associate.txt", "assoc.txt"];

pub(super) fn recognised(folder: &Folder) -> bool {
    [DEPTH_LIST, COLOUR_LIST].into_iter().chain(ASSOCIATIONS).any(|name| folder.has(name))
}

/// The file that pairs depth and colour images, if there is one.
pub(super) fn associations_file(folder: &Folder) -> Option<PathBuf> {
    ASSOCIATIONS.into_iter().find_map(|name| folder.file(name))
}

pub(super) fn list(folder: &Folder) -> Result<Listing, Error> {
    let ground_truth = folder.file("groundtruth.txt").map(|path| trajectory::read_tum(&path)).transpose()?;
    let frame = |timestamp, depth: PathBuf, colour: Option<(Timestamp, PathBuf)>| FrameFiles {
        colour_timestamp: colour.as_ref().map(|(time, _)| *time),
        colour: colour.map(|(_, path)| path),
        world_from_camera: ground_truth
            .as_ref()
            .and_then(|truth| truth.nearest(timestamp, TOLERANCE_NS))
            .map(|pose| pose.world_from_camera),
        // Numbered below, once the frames are in order.
        ..FrameFiles::new(depth, timestamp, Key::of_number(0))
    };
    let mut depth_without_colour = 0;
    let mut frames: Vec<FrameFiles> = if let Some(path) = associations_file(folder) {
        read_associations(folder, &path)?
            .into_iter()
            .map(|a| frame(a.time, a.depth, Some((a.colour_time, a.colour))))
            .collect()
    } else {
        let depth_list = folder.path.join(DEPTH_LIST);
        let depth = read_list(folder, &depth_list)?;
        if let Some(colour_list) = folder.file(COLOUR_LIST) {
            let colour = read_list(folder, &colour_list)?;
            let times = |list: &[Listed]| list.iter().map(|image| image.time).collect::<Vec<_>>();
            let pairs = associate(&times(&depth), &times(&colour), TOLERANCE_NS);
            if pairs.is_empty() {
                return Err(no_association(depth_list, &depth, colour_list, &colour));
            }
            depth_without_colour = depth.len() - pairs.len();
            let pair = |&(d, c): &(usize, usize)| {
                let (depth, colour): (&Listed, &Listed) = (&depth[d], &colour[c]);
                frame(depth.time, depth.path.clone(), Some((colour.time, colour.path.clone())))
            };
            pairs.iter().map(pair).collect()
        } else {
            depth.into_iter().map(|image| frame(image.time, image.path, None)).collect()
        }
    };
    frames.sort_by_key(|frame| frame.timestamp);
    let gyroscope = folder.file(GYROSCOPE).map(|path| read_gyroscope(&path)).transpose()?;
    let stamps: Vec<Timestamp> = frames.iter().map(|frame| frame.timestamp).collect();
    let readings = readings_by_frame(gyroscope.as_deref().unwrap_or_default(), &stamps);
    for ((position, frame), readings) in (0..).zip(&mut frames).zip(readings) {
        frame.key = Key::of_number(position);
        frame.gyroscope = readings;
    }
    Ok(Listing {
        preset: Some(preset(folder)),
        folder: folder.clone(),
        frames,
        depth_without_colour,
        has_timestamps: true,
        has_gyroscope: gyroscope.is_some_and(|readings| !readings.is_empty()),
        ground_truth,
    })
}

/// An image in a list.
struct Listed {
    time: Timestamp,
    path: PathBuf,
}

/// Reads lines of `timestamp filename`.
fn read_list(folder: &Folder, path: &Path) -> Result<Vec<Listed>, Error> {
    if !path.exists() {
        return Err(Error::NotFound { path: path.to_path_buf() });
    }
    let expected = "a time stamp and a file name";
    let mut images = Vec::new();
    for (number, line) in text::data_lines(&text::read(path)?) {
        let image = line.split_once(char::is_whitespace).and_then(|(time, name)| {
            Some(Listed { time: text::parse_seconds(time)?, path: folder.path.join(name.trim()) })
        });
        images.push(image.ok_or_else(|| Error::line(path, number, expected, text::quoted(line)))?);
    }
    if images.is_empty() {
        return Err(Error::NoFrames { path: path.to_path_buf(), expected: format!("lines with {expected}") });
    }
    Ok(images)
}

/// Reads a gyroscope's lines of `timestamp wx wy wz` (rad/s), and brings them into the order of time.
fn read_gyroscope(path: &Path) -> Result<Vec<AngularRate>, Error> {
    let expected = "4 finite numbers 'timestamp wx wy wz' (seconds and rad/s)";
    let parse = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let &[time, x, y, z] = words.as_slice() else { return None };
        let number = |word: &str| word.parse().ok().filter(|v: &f64| v.is_finite());
        let rad_per_s = DVec3::new(number(x)?, number(y)?, number(z)?);
        Some(AngularRate { timestamp: text::parse_seconds(time)?, rad_per_s })
    };
    let mut readings = Vec::new();
    for (number, line) in text::data_lines(&text::read(path)?) {
        readings.push(parse(line).ok_or_else(|| Error::line(path, number, expected, text::quoted(line)))?);
    }
    readings.sort_by_key(|reading| reading.timestamp);
    Ok(readings)
}

/// A depth image and its colour image.
pub(super) struct Association {
    /// Number of the line, from 1.
    pub(super) line: usize,
    /// Of the depth image.
    pub(super) time: Timestamp,
    pub(super) depth: PathBuf,
    pub(super) colour_time: Timestamp,
    pub(super) colour: PathBuf,
}

/// Reads lines of `timestamp filename timestamp filename`, depth or colour first.
pub(super) fn read_associations(folder: &Folder, path: &Path) -> Result<Vec<Association>, Error> {
    let expected = "4 values (time stamp and file name of a depth image and of its colour image)";
    let mut associations = Vec::new();
    let mut depth_first = None;
    for (line, text) in text::data_lines(&text::read(path)?) {
        let words: Vec<&str> = text.split_whitespace().collect();
        let &[first_time, first, second_time, second] = words.as_slice() else {
            let found = format!("{}: {}", words.len(), text::quoted(text));
            return Err(Error::line(path, line, expected, found));
        };
        let depth_first = match depth_first {
            Some(known) => known,
            None => *depth_first.insert(is_depth_first(folder, first, second)?),
        };
        let time =
            |word| text::parse_seconds(word).ok_or_else(|| Error::line(path, line, "a time stamp", text::quoted(word)));
        let (first, second) =
            ((time(first_time)?, folder.path.join(first)), (time(second_time)?, folder.path.join(second)));
        let (depth, colour) = if depth_first { (first, second) } else { (second, first) };
        associations.push(Association { line, time: depth.0, depth: depth.1, colour_time: colour.0, colour: colour.1 });
    }
    if associations.is_empty() {
        return Err(Error::NoFrames { path: path.to_path_buf(), expected: format!("lines with {expected}") });
    }
    Ok(associations)
}

/// Whether the first of two images that belong together is the depth image: by their names if these tell, otherwise by
/// their pixels.
fn is_depth_first(folder: &Folder, first: &str, second: &str) -> Result<bool, Error> {
    let says = |name: &str, words: &[&str]| words.iter().any(|word| name.to_lowercase().contains(word));
    let vote = |words: &[&str]| match (says(first, words), says(second, words)) {
        (true, false) => Some(true),
        (false, true) => Some(false),
        _ => None,
    };
    match vote(&["depth"]).or_else(|| vote(&["rgb", "color", "colour"]).map(|colour_first| !colour_first)) {
        Some(depth_first) => Ok(depth_first),
        None => decode::is_depth(&folder.path.join(first)),
    }
}

/// Pairs two lists of times one to one, the closest first, as the benchmark's tools do: indices into both, in the order
/// of the first list's times. Pairs lie at most `tolerance_ns` apart.
pub(super) fn associate(a: &[Timestamp], b: &[Timestamp], tolerance_ns: i64) -> Vec<(usize, usize)> {
    let mut b_by_time: Vec<usize> = (0..b.len()).collect();
    b_by_time.sort_by_key(|&j| b[j]);
    let mut candidates = Vec::new();
    for (i, time) in a.iter().enumerate() {
        let from = b_by_time.partition_point(|&j| b[j].0 < time.0.saturating_sub(tolerance_ns));
        for &j in &b_by_time[from..] {
            let distance = distance_ns(*time, b[j]);
            if distance > tolerance_ns {
                break;
            }
            candidates.push((distance, *time, b[j], i, j));
        }
    }
    candidates.sort_unstable();
    let (mut a_taken, mut b_taken) = (vec![false; a.len()], vec![false; b.len()]);
    let mut pairs = Vec::new();
    for (_, _, _, i, j) in candidates {
        if !a_taken[i] && !b_taken[j] {
            (a_taken[i], b_taken[j]) = (true, true);
            pairs.push((i, j));
        }
    }
    pairs.sort_by_key(|&(i, _)| (a[i], i));
    pairs
}

fn distance_ns(a: Timestamp, b: Timestamp) -> i64 {
    a.0.saturating_sub(b.0).saturating_abs()
}

/// How far apart in time the closest two of two lists are, in seconds.
pub(super) fn closest_s(a: &[Timestamp], b: &[Timestamp]) -> f64 {
    let mut b = b.to_vec();
    b.sort();
    let closest_ns = a.iter().map(|&time| {
        let at = b.partition_point(|&other| other < time);
        let neighbours = b[at.saturating_sub(1)..].iter().take(2);
        neighbours.map(|&other| distance_ns(other, time)).min().unwrap_or(i64::MAX)
    });
    Timestamp(closest_ns.min().unwrap_or(i64::MAX)).as_secs_f64()
}

fn no_association(depth_list: PathBuf, depth: &[Listed], colour_list: PathBuf, colour: &[Listed]) -> Error {
    let times = |list: &[Listed]| list.iter().map(|image| image.time).collect::<Vec<_>>();
    Error::NoAssociation {
        depth_list,
        depth_images: depth.len(),
        colour_list,
        colour_images: colour.len(),
        tolerance_ms: TOLERANCE_MS,
        closest_s: closest_s(&times(depth), &times(colour)),
    }
}

/// The published calibrations of the benchmark's three Kinects' colour cameras, which all took 640x480 images with
/// registered depth. The third one's images are undistorted already.
const PRESETS: [(&str, Intrinsics, Distortion); 3] = [
    (
        "fr1",
        Intrinsics::new(640, 480, 517.3, 516.5, 318.6, 255.3),
        Distortion::brown([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
    ),
    (
        "fr2",
        Intrinsics::new(640, 480, 520.9, 521.0, 325.1, 249.7),
        Distortion::brown([0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
    ),
    ("fr3", Intrinsics::new(640, 480, 535.4, 539.2, 320.1, 247.6), Distortion::None),
];

/// Depth was registered to the colour image as the lens shows it, so that the lens is undone for both images.
///
/// This was measured on the first 110 frames of fr1/rpy. Depth edges lie 5 and 4 pixels right of the colour image's near the
/// left and right border, where the lens moves pixels by 5 to the left and 8 to the right: they follow it. Frames 0.2 and
/// 0.4 s apart, aligned by ICP, move as motion capture says to 22 and 44 mm (medians) with the images as they are, to 15 and
/// 27 mm with both undistorted; of none, colour alone and both, the mean photometric error of such pairs is smallest with
/// both. Tracking by depth has an ATE of 87 mm without, and of 60 mm with both undistorted.
fn registered(camera: Intrinsics, lens: Distortion) -> Calibration {
    Calibration {
        depth_distortion: lens,
        colour_distortion: lens,
        ..Calibration::registered(camera, DepthConversion::TUM)
    }
}

/// What ROS assumes of a Kinect that nobody calibrated.
const ROS_DEFAULT: Intrinsics = Intrinsics::new(640, 480, 525.0, 525.0, 319.5, 239.5);

fn preset(folder: &Folder) -> Preset {
    let with = |(name, camera, lens): (&str, Intrinsics, Distortion), from: String| Preset {
        calibration: registered(camera, lens),
        source: format!(
            "TUM preset {name}{}, recognised from {from}",
            if lens.is_none() { "" } else { " with its lens's distortion" }
        ),
    };
    for part in folder.path_parts() {
        if let Some(preset) = preset_in(&part) {
            return with(preset, format!("'{part}' in the path"));
        }
    }
    // The benchmark's lists name the recording that they were made from, which survives a folder's renaming.
    for list in [DEPTH_LIST, COLOUR_LIST] {
        let text = folder.file(list).and_then(|path| text::read(&path).ok()).unwrap_or_default();
        let mut comments = text.lines().take_while(|line| line.starts_with('#'));
        if let Some(preset) = comments.find_map(preset_in) {
            return with(preset, format!("the comment in {list}"));
        }
    }
    Preset {
        calibration: Calibration::registered(ROS_DEFAULT, DepthConversion::TUM),
        source: "ROS default for a Kinect (fx = fy = 525), as neither fr1, fr2, fr3 nor a calibration file was found"
            .into(),
    }
}

/// The preset named in a text: `freiburg1` anywhere, or `fr1` with no letter before and no digit behind.
fn preset_in(text: &str) -> Option<(&'static str, Intrinsics, Distortion)> {
    let text = text.to_lowercase();
    PRESETS.into_iter().find(|(name, ..)| {
        let number = &name[2..];
        let not_a_digit = |rest: &str| !rest.starts_with(|c: char| c.is_ascii_digit());
        let long = format!("freiburg{number}");
        text.match_indices(&long).any(|(at, _)| not_a_digit(&text[at + long.len()..]))
            || text
                .match_indices(name)
                .any(|(at, _)| not_a_digit(&text[at + name.len()..]) && !text[..at].ends_with(char::is_alphanumeric))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn times(ms: &[i64]) -> Vec<Timestamp> {
        ms.iter().map(|ms| Timestamp(ms * 1_000_000)).collect()
    }

    #[test]
    fn the_closest_are_paired_first_and_each_once() {
        // 10 is closest to 12, although 0 comes first and could take it.
        let pairs = associate(&times(&[0, 10, 100]), &times(&[12, 79, 121]), TOLERANCE_NS);
        assert_eq!(pairs, [(1, 0)]);
        // 20 ms are near enough; lists need no order.
        let pairs = associate(&times(&[100, 0]), &times(&[20, 80]), TOLERANCE_NS);
        assert_eq!(pairs, [(1, 0), (0, 1)]);
    }

    proptest! {
        #[test]
        fn pairs_are_near_unique_and_leave_nothing_that_could_be_paired(
            a in prop::collection::vec(0..300i64, 0..12),
            b in prop::collection::vec(0..300i64, 0..12),
        ) {
            let pairs = associate(&times(&a), &times(&b), TOLERANCE_NS);
            let left_out = |i: usize, j: usize| pairs.iter().all(|&(p, q)| p != i && q != j);
            for (i, x) in a.iter().enumerate() {
                prop_assert!(pairs.iter().filter(|p| p.0 == i).count() <= 1);
                for (j, y) in b.iter().enumerate() {
                    prop_assert!(pairs.iter().filter(|p| p.1 == j).count() <= 1);
                    prop_assert!(!pairs.contains(&(i, j)) || (x - y).abs() <= TOLERANCE_MS);
                    prop_assert!(!left_out(i, j) || (x - y).abs() > TOLERANCE_MS);
                }
            }
        }
    }

    #[test]
    fn presets_are_recognised_by_whole_names() {
        let name = |text| preset_in(text).map(|(name, ..)| name);
        assert_eq!(name("rgbd_dataset_freiburg1_desk"), Some("fr1"));
        assert_eq!(name("Freiburg3"), Some("fr3"));
        assert_eq!(name("tum_fr2_xyz"), Some("fr2"));
        assert_eq!(name("fr10"), None);
        assert_eq!(name("freiburg12"), None);
        assert_eq!(name("afr1"), None);
        assert_eq!(name("desk"), None);
    }
}
