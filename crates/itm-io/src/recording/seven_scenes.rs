//! 7-Scenes: `frame-000000.color.png`, `frame-000000.depth.png`, `frame-000000.pose.txt` and so on (Shotton et al.
//! 2013, *Scene Coordinate Regression Forests for Camera Relocalization in RGB-D Images*).

use std::collections::BTreeMap;

use glam::DVec3;
use itm_core::{Calibration, DepthConversion, Intrinsics, Se3, StampedPose, Trajectory};

use super::images::Key;
use super::{Folder, FrameFiles, Listing, Preset, nominal_timestamp};
use crate::{Error, matrix};

/// The Kinect's factory values; images of its two cameras are not registered.
const DEPTH_CAMERA: Intrinsics = Intrinsics::new(640, 480, 585.0, 585.0, 320.0, 240.0);
const COLOUR_CAMERA: Intrinsics = Intrinsics::new(640, 480, 525.0, 525.0, 320.0, 240.0);
/// The colour camera sits 2.5 cm to the right of the depth camera by the Kinect's design. On the red kitchen, depth
/// edges laid over colour edges fit best between 2 and 2.5 cm.
const COLOUR_FROM_DEPTH: DVec3 = DVec3::new(-0.025, 0.0, 0.0);

const DEPTH_SUFFIX: &str = ".depth.png";
const COLOUR_SUFFIXES: [&str; 3] = [".color.png", ".color.jpg", ".color.jpeg"];

/// The digits of `frame-000012.depth.png`.
fn digits<'a>(name: &'a str, suffix: &str) -> Option<&'a str> {
    let digits = name.strip_prefix("frame-")?.strip_suffix(suffix)?;
    digits.parse::<u32>().ok().map(|_| digits)
}

fn has_frames(folder: &Folder) -> bool {
    folder.names.iter().any(|name| digits(name, DEPTH_SUFFIX).is_some())
}

fn sequences(folder: &Folder) -> Vec<String> {
    let is_sequence = |name: &&String| name.strip_prefix("seq-").is_some_and(|number| number.parse::<u32>().is_ok());
    let has_frames = |name: &&String| Folder::list(&folder.path.join(name)).is_ok_and(|folder| has_frames(&folder));
    folder.names.iter().filter(is_sequence).filter(has_frames).cloned().collect()
}

pub(super) fn recognised(folder: &Folder) -> bool {
    has_frames(folder) || !sequences(folder).is_empty()
}

pub(super) fn list(folder: &Folder) -> Result<Listing, Error> {
    if has_frames(folder) {
        return list_sequence(folder.clone());
    }
    match sequences(folder).as_slice() {
        [] => Err(Error::NoFrames {
            path: folder.path.clone(),
            expected: "frame-000000.depth.png and so on, or one folder seq-01 with such".into(),
        }),
        [one] => list_sequence(Folder::list(&folder.path.join(one))?),
        several => Err(Error::SeveralRecordings { path: folder.path.clone(), names: several.to_vec() }),
    }
}

fn list_sequence(folder: Folder) -> Result<Listing, Error> {
    let suffix = COLOUR_SUFFIXES.into_iter().find(|s| folder.names.iter().any(|name| digits(name, s).is_some()));
    let poses = Poses::read(&folder);
    // A frame is there if one of its images is; the other one missing is that frame's error.
    let of_a_frame = |name: &String| {
        let digits = digits(name, DEPTH_SUFFIX).or_else(|| digits(name, suffix?))?;
        Some((digits.parse().ok()?, digits.to_string()))
    };
    let frames: BTreeMap<u32, String> = folder.names.iter().filter_map(of_a_frame).collect();
    let frames = frames
        .into_iter()
        .map(|(number, digits)| {
            let file = |suffix: &str| folder.path.join(format!("frame-{digits}{suffix}"));
            FrameFiles {
                colour: suffix.map(file),
                world_from_camera: poses.0.get(&number).copied(),
                ..FrameFiles::new(file(DEPTH_SUFFIX), nominal_timestamp(number), Key::of_number(number.into()))
            }
        })
        .collect();
    Ok(Listing {
        folder,
        frames,
        preset: Some(Preset {
            calibration: Calibration {
                colour: COLOUR_CAMERA,
                colour_from_depth: Se3 { translation: COLOUR_FROM_DEPTH, ..Se3::IDENTITY },
                ..Calibration::registered(DEPTH_CAMERA, DepthConversion::MILLIMETRES)
            },
            source: "7-Scenes preset (depth f = 585, colour f = 525, 2.5 cm apart), recognised from the files' names"
                .into(),
        }),
        depth_without_colour: 0,
        has_timestamps: false,
        has_gyroscope: false,
        ground_truth: poses.into_trajectory(),
    })
}

/// Poses by frame number.
struct Poses(BTreeMap<u32, Se3>);

impl Poses {
    /// Reads every pose file. One that cannot be read leaves its frame without a pose; that happens where the system
    /// that made the ground truth was lost, and is told once.
    fn read(folder: &Folder) -> Self {
        let mut poses = BTreeMap::new();
        let mut bad = Vec::new();
        for name in &folder.names {
            let Some(Ok(number)) = digits(name, ".pose.txt").map(str::parse) else { continue };
            match matrix::read_pose(&folder.path.join(name)) {
                Ok(pose) => {
                    poses.insert(number, pose);
                }
                Err(error) => bad.push(error),
            }
        }
        if let Some(first) = bad.first() {
            tracing::warn!("{} frames have no true pose, the first because of {first}", bad.len());
        }
        Self(poses)
    }

    fn into_trajectory(self) -> Option<Trajectory> {
        let stamped =
            |(number, world_from_camera)| StampedPose { timestamp: nominal_timestamp(number), world_from_camera };
        if self.0.is_empty() { None } else { Some(self.0.into_iter().map(stamped).collect()) }
    }
}
