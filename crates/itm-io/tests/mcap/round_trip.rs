//! What `McapWriter` writes is read as it was.

use std::fs;
use std::path::Path;

use image::{ImageBuffer, Luma, Rgb, RgbImage};
use itm_core::{DepthConversion, DepthImage, Frame, Timestamp};
use itm_io::recording::{self, McapWriter, OpenOptions, Recording, RecordingInfo};

use crate::open;

const FRAMES: usize = 6;

/// A TUM folder with a gyroscope, true poses between frames and a calibration with lenses.
fn write_tum(folder: &Path, conversion: &str) {
    let (mut depth, mut colour, mut truth, mut gyroscope) = <(String, String, String, String)>::default();
    for number in 0..FRAMES {
        let time = 1_305_031_102.175_304 + number as f64 * 0.033_3;
        // Farther apart than half a frame's period now and then.
        let colour_time = time + if number == 3 { 0.019 } else { 0.002 };
        depth += &format!("{time:.6} d{number}.png\n");
        colour += &format!("{colour_time:.6} c{number}.png\n");
        let value = |x: u32, y: u32| Luma([(x * 4001 + y * 701 + number as u32 * 13) as u16]);
        ImageBuffer::from_fn(9, 7, value).save(folder.join(format!("d{number}.png"))).unwrap();
        let rgb = |x: u32, y: u32| Rgb([(x * 25) as u8, (y * 31) as u8, (x * y + number as u32) as u8]);
        RgbImage::from_fn(11, 5, rgb).save(folder.join(format!("c{number}.png"))).unwrap();
        for step in 0..4 {
            let at = time + f64::from(step) * 0.0083;
            let x = (number * 4) as f64 + f64::from(step);
            truth +=
                &format!("{at:.6} {} {} 0.3 0.1 {} 0.2 0.9\n", x * 0.0137, (x * 0.1).sin(), (x * 0.05).cos() * 0.3);
            gyroscope += &format!("{:.6} {} 0.25 {}\n", at - 0.004, x * 0.0123, -x);
        }
    }
    // Quaternions of any length are none: those above are brought to unit length here.
    let truth: Vec<String> = truth
        .lines()
        .map(|line| {
            let n: Vec<f64> = line.split(' ').skip(1).map(|n| n.parse().unwrap()).collect();
            let length = (n[3] * n[3] + n[4] * n[4] + n[5] * n[5] + n[6] * n[6]).sqrt();
            let time = line.split(' ').next().unwrap();
            format!(
                "{time} {} {} {} {} {} {} {}",
                n[0],
                n[1],
                n[2],
                n[3] / length,
                n[4] / length,
                n[5] / length,
                n[6] / length
            )
        })
        .collect();
    let calibration = format!(
        "11 5\n9.1 9.2\n5.03 2.01\n\n9 7\n8.3 8.4\n4.01 3.02\n\n0.9998 -0.02 0 0.0251\n0.02 0.9998 0 -0.0012\n0 0 1 0.0003\n\n\
         {conversion}\n\ncolour-distortion brown 0.02 -0.03 0.001 0.002 0.003\n\
         depth-distortion rational 0.01 0.02 0.001 0.002 0.003 0.004 0.005 0.006\n"
    );
    let files = [
        ("depth.txt", depth),
        ("rgb.txt", colour),
        ("groundtruth.txt", truth.join("\n")),
        ("gyroscope.txt", gyroscope),
        ("calibration.txt", calibration),
    ];
    for (name, text) in files {
        fs::write(folder.join(name), text).unwrap();
    }
}

fn convert(recording: &mut dyn Recording, path: &Path) {
    let mut writer = McapWriter::create(path, recording.info()).unwrap();
    for index in 0..recording.info().frames {
        writer.write(&recording.read(index).unwrap()).unwrap();
    }
    writer.finish().unwrap();
}

/// As the stage `view` makes metres of it.
fn metres(depth: &DepthImage, conversion: DepthConversion) -> Vec<u32> {
    let DepthConversion::Affine { scale, offset } = conversion else { panic!("not affine") };
    let convert = |value: u16| match value {
        0 | u16::MAX => 0.0,
        value => f32::from(value) * scale as f32 + offset as f32,
    };
    match depth {
        DepthImage::Raw(image) => image.data().iter().map(|&value| convert(value).to_bits()).collect(),
        DepthImage::Metres(image) => image.data().iter().map(|value| value.to_bits()).collect(),
    }
}

fn assert_same(a: (&Frame, &RecordingInfo), b: (&Frame, &RecordingInfo)) {
    assert_eq!(
        metres(&a.0.depth, a.1.calibration.depth_conversion),
        metres(&b.0.depth, b.1.calibration.depth_conversion)
    );
    assert_eq!(a.0.colour, b.0.colour);
    assert_eq!((a.0.timestamp, a.0.colour_timestamp), (b.0.timestamp, b.0.colour_timestamp));
    assert_eq!(a.0.gyroscope, b.0.gyroscope);
}

#[test]
fn a_recording_comes_back_as_it_was() {
    for (conversion, is_raw) in [("affine 0.0002 0", false), ("affine 0.001 0", true)] {
        let folder = tempfile::tempdir().unwrap();
        write_tum(folder.path(), conversion);
        let mut tum = recording::open(folder.path(), &OpenOptions::default()).unwrap();
        let path = folder.path().join("copy.mcap");
        convert(tum.as_mut(), &path);
        let mut mcap = open(&path);
        let (a, b) = (tum.info().clone(), mcap.info().clone());
        assert_eq!((a.frames, a.has_colour, a.has_gyroscope), (FRAMES, true, true));
        assert_eq!((b.frames, b.has_colour, b.has_gyroscope, b.has_timestamps), (FRAMES, true, true, true));
        assert_eq!(a.ground_truth, b.ground_truth);
        let expected = itm_core::Calibration { depth_conversion: DepthConversion::MILLIMETRES, ..a.calibration };
        assert_eq!(b.calibration, expected);
        for index in 0..FRAMES {
            let (from, to) = (tum.read(index).unwrap(), mcap.read(index).unwrap());
            assert_same((&from, &a), (&to, &b));
            assert_eq!(matches!(to.depth, DepthImage::Raw(_)), is_raw);
            // The truth has a pose at the frame's very time.
            assert_eq!(from.world_from_camera, to.world_from_camera);
        }
        // And once more, to the same messages.
        let again = folder.path().join("again.mcap");
        convert(mcap.as_mut(), &again);
        let mut again = open(&again);
        assert_eq!(again.info().calibration, b.calibration);
        for index in 0..FRAMES {
            assert_same((&mcap.read(index).unwrap(), &b), (&again.read(index).unwrap(), &b));
        }
    }
}

#[test]
fn frames_without_colour_and_nominal_times_come_back() {
    let folder = tempfile::tempdir().unwrap();
    write_tum(folder.path(), "affine 0.001 0");
    let mut tum = recording::open(folder.path(), &OpenOptions::default()).unwrap();
    let info = RecordingInfo { has_timestamps: false, ground_truth: None, ..tum.info().clone() };
    let path = folder.path().join("copy.mcap");
    let mut writer = McapWriter::create(&path, &info).unwrap();
    for number in 0..4_u32 {
        let mut frame = tum.read(number as usize).unwrap();
        frame.timestamp = recording::nominal_timestamp(number);
        frame.colour_timestamp = None;
        if number == 2 {
            frame.colour = None;
        }
        writer.write(&frame).unwrap();
    }
    writer.finish().unwrap();
    let mut mcap = open(&path);
    assert!(!mcap.info().has_timestamps);
    assert_eq!((mcap.info().frames, mcap.info().depth_without_colour), (4, 0));
    assert!(mcap.read(2).unwrap().colour.is_none() && mcap.read(3).unwrap().colour.is_some());
    assert_eq!(mcap.info().image_number(mcap.timestamp(3).unwrap()), Some(3));
    assert_eq!(mcap.read(1).unwrap().world_from_camera, tum.read(1).unwrap().world_from_camera);
    assert_eq!(mcap.info().ground_truth.as_ref().unwrap().poses()[0].timestamp, Timestamp(0));
}

#[test]
fn a_file_that_is_given_up_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("source");
    fs::create_dir(&source).unwrap();
    write_tum(&source, "affine 0.001 0");
    let mut tum = recording::open(&source, &OpenOptions::default()).unwrap();
    let target = folder.path().join("target");
    fs::create_dir(&target).unwrap();
    let path = target.join("copy.mcap");
    let mut writer = McapWriter::create(&path, tum.info()).unwrap();
    writer.write(&tum.read(0).unwrap()).unwrap();
    drop(writer);
    assert_eq!(fs::read_dir(&target).unwrap().count(), 0);
    assert!(McapWriter::create(&folder.path().join("nowhere/copy.mcap"), tum.info()).is_err());
}

#[test]
fn real_recordings_come_back_as_they_were() {
    let Some(data) = std::env::var_os("ITM_TEST_DATA") else {
        println!("skipped: ITM_TEST_DATA names no folder of real recordings");
        return;
    };
    for name in ["tum_fr1_rpy_head", "icl_lr_kt2_head", "7scenes_redkitchen_head"] {
        const FRAMES: usize = 4;
        let mut real = recording::open(&Path::new(&data).join(name), &OpenOptions::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("real.mcap");
        let mut writer = McapWriter::create(&path, real.info()).unwrap();
        for index in 0..FRAMES {
            writer.write(&real.read(index).unwrap()).unwrap();
        }
        writer.finish().unwrap();
        let mut mcap = open(&path);
        let (a, b) = (real.info().clone(), mcap.info().clone());
        assert_eq!((b.frames, b.has_timestamps), (FRAMES, a.has_timestamps), "{name}");
        assert_eq!(a.ground_truth, b.ground_truth, "{name}");
        let expected = itm_core::Calibration { depth_conversion: DepthConversion::MILLIMETRES, ..a.calibration };
        assert_eq!(b.calibration, expected, "{name}");
        for index in 0..FRAMES {
            let (mut from, to) = (real.read(index).unwrap(), mcap.read(index).unwrap());
            // Where depth and colour have no times of their own they are taken for the same.
            from.colour_timestamp = from.colour_timestamp.or(Some(from.timestamp));
            assert_same((&from, &a), (&to, &b));
        }
    }
}
