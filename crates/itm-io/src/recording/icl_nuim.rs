//! ICL-NUIM: synthetic living rooms and offices in the TUM-like form that their makers offer (Handa et al. 2014, *A
//! Benchmark for RGB-D Visual Odometry, 3D Reconstruction and SLAM*).
//!
//! Its camera has `fy < 0`: the y axis points up, and the ground truth is for that camera. Where others have times its
//! files have the image's number; image 0 has no pose.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use itm_core::{Calibration, DepthConversion, Intrinsics, StampedPose, Timestamp, Trajectory};

use super::images::Key;
use super::{Folder, FrameFiles, Listing, Preset, nominal_from_time_column, nominal_timestamp, tum};
use crate::{Error, trajectory};

const CAMERA: Intrinsics = Intrinsics::new(640, 480, 481.2, -480.0, 319.5, 239.5);

pub(super) fn recognised(folder: &Folder) -> bool {
    let numbered = || ["0.png", "1.png"].iter().any(|name| folder.path.join("depth").join(name).is_file());
    let telling = |name: &str| {
        let name = name.to_lowercase();
        ["livingroom", "living_room", "officeroom", "office_room", "traj", "icl"].iter().any(|word| name.contains(word))
    };
    // The folder's own name and its parent's, and its files'.
    let resolved = folder.path.canonicalize().unwrap_or_else(|_| folder.path.clone());
    let own = || resolved.components().rev().take(2).any(|part| telling(&part.as_os_str().to_string_lossy()));
    ground_truth_file(folder).is_some() || numbered() && (own() || folder.names.iter().any(|name| telling(name)))
}

fn ground_truth_file(folder: &Folder) -> Option<PathBuf> {
    folder.names.iter().find(|name| name.ends_with(".gt.freiburg")).map(|name| folder.path.join(name))
}

pub(super) fn list(folder: &Folder) -> Result<Listing, Error> {
    let ground_truth = ground_truth_file(folder).or_else(|| folder.file("groundtruth.txt"));
    let ground_truth = ground_truth.map(|path| read_ground_truth(&path)).transpose()?;
    let images = match tum::associations_file(folder) {
        Some(path) => associated_images(folder, &path)?,
        None => numbered_images(folder)?,
    };
    let frames = images
        .into_iter()
        .map(|(number, (depth, colour))| {
            let timestamp = nominal_timestamp(number);
            let pose = ground_truth.as_ref().and_then(|truth| truth.nearest(timestamp, 0));
            FrameFiles {
                colour,
                world_from_camera: pose.map(|p| p.world_from_camera),
                ..FrameFiles::new(depth, timestamp, Key::of_number(number.into()))
            }
        })
        .collect();
    Ok(Listing {
        folder: folder.clone(),
        frames,
        preset: Some(Preset {
            calibration: Calibration::registered(CAMERA, DepthConversion::TUM),
            source: "ICL-NUIM's camera (fx = 481.2, fy = -480), recognised from the folder".into(),
        }),
        depth_without_colour: 0,
        has_timestamps: false,
        has_gyroscope: false,
        ground_truth,
    })
}

type ImagesByNumber = BTreeMap<u32, (PathBuf, Option<PathBuf>)>;

fn associated_images(folder: &Folder, path: &Path) -> Result<ImagesByNumber, Error> {
    let mut images = BTreeMap::new();
    for association in tum::read_associations(folder, path)? {
        let tum::Association { line, time, depth, colour, colour_time: _ } = association;
        let number = image_number(time)
            .ok_or_else(|| Error::line(path, line, "an image number in the time column", format!("{time}")))?;
        if images.insert(number, (depth, Some(colour))).is_some() {
            return Err(Error::line(path, line, "an image number that was not used before", number.to_string()));
        }
    }
    Ok(images)
}

/// The image number that was read as seconds.
fn image_number(time: Timestamp) -> Option<u32> {
    (time.0 % 1_000_000_000 == 0).then(|| u32::try_from(time.0 / 1_000_000_000).ok())?
}

/// Images by the numbers that are their names, `depth/0.png` and `rgb/0.png`, where no list pairs them.
fn numbered_images(folder: &Folder) -> Result<ImagesByNumber, Error> {
    let depth_folder = Folder::list(&folder.path.join("depth"))?;
    let colour_folder = folder.file("rgb").map(|path| Folder::list(&path)).transpose()?;
    let numbered = |name: &String| name.strip_suffix(".png")?.parse::<u32>().ok();
    let images: ImagesByNumber = depth_folder
        .names
        .iter()
        .filter_map(|name| {
            // A colour image that is missing is that frame's error.
            let colour = colour_folder.as_ref().map(|colour| colour.path.join(name));
            Some((numbered(name)?, (depth_folder.path.join(name), colour)))
        })
        .collect();
    if images.is_empty() {
        return Err(Error::NoFrames { path: depth_folder.path, expected: "numbered depth images, as 0.png".into() });
    }
    Ok(images)
}

/// The true poses, with the time of image n being the nominal one.
fn read_ground_truth(path: &Path) -> Result<Trajectory, Error> {
    let by_number = trajectory::read_tum(path)?;
    let nominal = |pose: &StampedPose| StampedPose { timestamp: nominal_from_time_column(pose.timestamp), ..*pose };
    Ok(by_number.poses().iter().map(nominal).collect())
}
