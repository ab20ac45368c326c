//! Recordings in MCAP through the public API: files of other people's libraries (`interchange.py`), files made here message
//! by message, what can be wrong with one, and the way there and back.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "the exemption of tests does not reach the helpers of a test that is a crate of its own"
)]

mod encodings;
mod files;
mod round_trip;
mod topics;

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use itm_core::{DepthImage, Distortion, Frame, Intrinsics, Se3, Timestamp};
use itm_io::recording::{self, Format, OpenOptions, Recording};

use crate::files::{FRAMES, H, START_NS, STEP_NS, W, colour_at, depth_at};

/// A file that `interchange.py` wrote.
fn of_others(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/mcap").join(name)
}

fn open(path: &Path) -> Box<dyn Recording> {
    open_with(path, "").unwrap()
}

fn open_with(path: &Path, topics: &str) -> Result<Box<dyn Recording>, String> {
    let topics = topics.parse().map_err(|error: itm_io::Error| error.to_string())?;
    recording::open(path, &OpenOptions { topics, ..OpenOptions::default() }).map_err(|error| error.to_string())
}

fn error(path: &Path) -> String {
    open_with(path, "").err().expect("an error")
}

/// Checks what all files have that `interchange.py` writes; depth is in millimetres or in metres.
fn check_frames(recording: &mut dyn Recording) -> Vec<Frame> {
    assert_eq!(recording.info().frames, FRAMES);
    let frames: Vec<Frame> = (0..FRAMES).map(|index| recording.read(index).unwrap()).collect();
    for (number, frame) in frames.iter().enumerate() {
        assert_eq!(frame.index, number as u64);
        assert_eq!(frame.timestamp, Timestamp(START_NS + number as i64 * STEP_NS));
        assert_eq!(recording.timestamp(number), Some(frame.timestamp));
        for y in 0..H {
            for x in 0..W {
                let expected = depth_at(number, x, y);
                match &frame.depth {
                    DepthImage::Raw(image) => assert_eq!(image[(x, y)], expected),
                    DepthImage::Metres(image) => assert_eq!(image[(x, y)], f32::from(expected) / 1000.0),
                }
                assert_eq!(frame.colour.as_ref().unwrap()[(x, y)], colour_at(number, x, y));
            }
        }
    }
    frames
}

const CAMERA: Intrinsics = Intrinsics::new(W, H, 20.0, 21.0, 7.5, 5.5);
const LENS: [f64; 5] = [0.01, -0.02, 0.001, 0.002, 0.003];

#[test]
fn messages_of_ros_2_are_read_in_chunks_of_zstd() {
    let mut recording = open(&of_others("ros2.mcap"));
    let frames = check_frames(recording.as_mut());
    let info = recording.info();
    assert_eq!((info.format, info.name.as_str()), (Format::Mcap, "ros2"));
    assert!(info.has_colour && info.has_timestamps && info.has_gyroscope);
    let calibration = info.calibration;
    assert_eq!((calibration.depth, calibration.colour), (CAMERA, CAMERA));
    assert_eq!(calibration.depth_distortion, Distortion::None);
    assert_eq!(calibration.colour_distortion, Distortion::brown(LENS));
    // Both are turned alike and lie 5 cm apart along the base's x axis, which is their -y axis.
    let expected = Se3::new(DQuat::IDENTITY, DVec3::new(0.0, 0.05, 0.0));
    let error = calibration.colour_from_depth * expected.inverse();
    assert!(error.log().iter().all(|x| x.abs() < 1e-12), "{:?}", calibration.colour_from_depth);
    for (number, frame) in frames.iter().enumerate() {
        assert_eq!(frame.colour_timestamp, Some(Timestamp(frame.timestamp.0 + 3_000_000)));
        let pose = frame.world_from_camera.unwrap();
        assert!(pose.translation.abs_diff_eq(DVec3::new(0.1 * number as f64 + 0.1, 0.0, 0.0), 1e-7), "{pose:?}");
        assert!(pose.transform_vector(DVec3::X).abs_diff_eq(DVec3::Y, 1e-12));
        let [reading] = frame.gyroscope[..] else { panic!("one reading a frame: {:?}", frame.gyroscope) };
        assert_eq!(reading.timestamp.0, frame.timestamp.0 - 1_000_000);
        assert_eq!(reading.rad_per_s, DVec3::new(0.1 * number as f64, 0.2, 0.3));
    }
    assert_eq!(info.ground_truth.as_ref().unwrap().len(), FRAMES + 2);
}

#[test]
fn compressed_images_are_read_in_chunks_of_lz4() {
    let mut recording = open(&of_others("ros2_compressed.mcap"));
    let frames = check_frames(recording.as_mut());
    let [k1, k2, p1, p2, k3] = LENS;
    let lens = Distortion::rational([k1, k2, p1, p2, k3, 0.1, 0.05, 0.01]);
    let calibration = recording.info().calibration;
    assert_eq!((calibration.depth_distortion, calibration.colour_distortion), (lens, lens));
    assert_eq!(calibration.colour_from_depth, Se3::IDENTITY);
    assert!(frames.iter().all(|frame| matches!(frame.depth, DepthImage::Raw(_))));
    // Odometry is of the camera's own frame.
    assert_eq!(frames[3].world_from_camera.unwrap().translation, DVec3::new(0.0, 1.5, 0.0));
}

#[test]
fn messages_of_foxglove_are_read_without_chunks() {
    let mut recording = open(&of_others("foxglove.mcap"));
    let frames = check_frames(recording.as_mut());
    assert!(frames.iter().all(|frame| matches!(frame.depth, DepthImage::Metres(_))));
    let calibration = recording.info().calibration;
    assert_eq!((calibration.depth, calibration.colour), (CAMERA, CAMERA));
    assert_eq!(calibration.colour_distortion, Distortion::brown(LENS));
    assert_eq!(calibration.colour_from_depth.translation, DVec3::new(0.05, 0.0, 0.0));
    assert_eq!(frames[4].world_from_camera.unwrap().translation, DVec3::new(0.0, 0.0, 1.0));
    // In any order.
    assert_eq!(recording.read(4).unwrap().depth, frames[4].depth);
    assert_eq!(recording.read(0).unwrap().depth, frames[0].depth);
    assert!(recording.read(FRAMES).is_err());
}

#[test]
fn a_file_that_is_cut_off_is_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    for name in ["ros2.mcap", "ros2_compressed.mcap", "foxglove.mcap"] {
        let whole = fs::read(of_others(name)).unwrap();
        let mut counts = Vec::new();
        for length in (0..whole.len()).step_by(61) {
            fs::write(&path, &whole[..length]).unwrap();
            let frames = open_with(&path, "").map_or(0, |mut recording| {
                let frames = recording.info().frames;
                for index in 0..frames {
                    assert!(recording.read(index).is_ok(), "{name}, {length} bytes, frame {index}");
                }
                frames
            });
            counts.push(frames);
        }
        // A first colour image may come before its camera's calibration.
        assert!(counts.iter().skip_while(|&&frames| frames < 2).is_sorted(), "{name}: {counts:?}");
        assert_eq!(counts.last(), Some(&FRAMES));
        // What is left of a compressed chunk is read by whole blocks; messages in the file itself one by one.
        let met = (0..=FRAMES).filter(|n| counts.contains(n)).count();
        assert!(met >= if name == "foxglove.mcap" { FRAMES + 1 } else { 3 }, "{name}: {counts:?}");
    }
}

#[test]
fn damage_is_an_error_or_leaves_out_what_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.mcap");
    for name in ["ros2.mcap", "ros2_compressed.mcap", "foxglove.mcap"] {
        let whole = fs::read(of_others(name)).unwrap();
        for at in (0..whole.len()).step_by(37) {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x55;
            fs::write(&path, &damaged).unwrap();
            if let Ok(mut recording) = open_with(&path, "") {
                for index in 0..recording.info().frames {
                    // What is damaged may be an error, but not the end of the program.
                    let _frame = recording.read(index);
                }
            }
        }
    }
}

#[test]
fn what_is_no_mcap_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.mcap");
    fs::write(&path, b"").unwrap();
    assert!(error(&path).ends_with("empty.mcap' as MCAP: it does not begin as an MCAP file does"), "{}", error(&path));
    let text = folder.path().join("text.txt");
    fs::write(&text, b"text").unwrap();
    assert!(error(&text).contains("a recording is a folder, or a file in the format MCAP"));
    let options = OpenOptions { depth_pattern: Some("*.png".into()), ..OpenOptions::default() };
    let refused = recording::open(&of_others("ros2.mcap"), &options).err().unwrap().to_string();
    assert!(refused.contains("patterns of files are of recordings in the format images"), "{refused}");
}

#[test]
fn a_folder_may_hold_one_file_and_its_name_need_not_tell() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str| fs::copy(of_others("ros2.mcap"), folder.path().join(name)).unwrap();
    put("bag_0.mcap");
    assert_eq!(open(folder.path()).info().frames, FRAMES);
    put("bag_1.mcap");
    let several = error(folder.path());
    assert!(several.contains("several recordings (bag_0.mcap, bag_1.mcap)"), "{several}");
    put("without_an_ending");
    assert_eq!(open(&folder.path().join("without_an_ending")).info().format, Format::Mcap);
}

#[test]
fn a_calibration_file_wins() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("calibration.txt");
    let camera = "16 12\n30 31\n7 6\n\n";
    fs::write(&file, format!("{camera}{camera}1 0 0 0\n0 1 0 0\n0 0 1 0\n\naffine 0.0002 0\n")).unwrap();
    let options = OpenOptions { calibration: Some(file.clone()), ..OpenOptions::default() };
    let recording = recording::open(&of_others("ros2.mcap"), &options).unwrap();
    assert_eq!(recording.info().calibration.depth.fx, 30.0);
    fs::copy(of_others("ros2.mcap"), folder.path().join("one.mcap")).unwrap();
    assert_eq!(open(folder.path()).info().calibration.depth.fx, 30.0);
    fs::write(&file, fs::read_to_string(&file).unwrap().replace("16 12", "32 24")).unwrap();
    let refused = error(folder.path());
    assert!(refused.contains("topic '/camera/depth/image_raw': expected images of 32x24 pixels"), "{refused}");
}
