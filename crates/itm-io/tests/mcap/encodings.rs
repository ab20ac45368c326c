//! Every encoding of images, and of cameras.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, RgbImage};
use itm_core::{DepthImage, Distortion, Intrinsics};
use tempfile::TempDir;

use crate::files::{H, INFO, Info, Mcap, START_NS, W, colour_at, compressed, depth_at, image, pixels};
use crate::{error, open};

/// A file with one frame, of which the depth image and its calibration are given; and a colour image, if any.
fn file(depth: (&str, &[u8]), info: &[u8], colour: Option<(&str, &[u8])>) -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.mcap");
    let mut mcap = Mcap::create(&path);
    mcap.put("/depth/image", depth.0, START_NS, depth.1).put(
        "/depth/camera_info",
        "sensor_msgs/CameraInfo",
        START_NS,
        info,
    );
    if let Some((schema, message)) = colour {
        mcap.put("/color/image", schema, START_NS, message);
        mcap.put("/color/camera_info", "sensor_msgs/CameraInfo", START_NS, &INFO.message("camera", false));
    }
    mcap.finish();
    (folder, path)
}

const IMAGE: &str = "sensor_msgs/Image";
const COMPRESSED: &str = "sensor_msgs/CompressedImage";

fn values() -> Vec<u16> {
    pixels().map(|(x, y)| depth_at(1, x, y)).collect()
}

fn png_16(values: &[u16]) -> Vec<u8> {
    let image = ImageBuffer::<Luma<u16>, _>::from_raw(W, H, values.to_vec()).unwrap();
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::from(image).write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn depth_of(schema: &str, message: &[u8], big_endian: bool) -> DepthImage {
    let (_folder, path) = file((schema, message), &INFO.message("camera", big_endian), None);
    let mut recording = open(&path);
    let camera = recording.info().calibration.depth;
    assert_eq!(camera, Intrinsics::new(W, H, 20.0, 21.0, 7.5, 5.5));
    recording.read(0).unwrap().depth
}

#[test]
fn depth_is_read_in_both_byte_orders_and_with_padded_rows() {
    for encoding in ["16UC1", "mono16"] {
        for big_endian in [false, true] {
            let mut data = Vec::new();
            for (i, value) in values().into_iter().enumerate() {
                data.extend(if big_endian { value.to_be_bytes() } else { value.to_le_bytes() });
                if (i + 1) % W as usize == 0 {
                    data.extend([0xff; 5]);
                }
            }
            // The last row need not be filled up.
            data.truncate(data.len() - 5);
            let message = image(START_NS, "camera", encoding, big_endian, 2 * W + 5, &data);
            let DepthImage::Raw(depth) = depth_of(IMAGE, &message, big_endian) else { panic!("{encoding} is raw") };
            assert_eq!(depth.data(), values());
        }
    }
    let metres: Vec<f32> = values().iter().map(|&value| f32::from(value) * 0.001).collect();
    for big_endian in [false, true] {
        let bytes = metres.iter().flat_map(|m| if big_endian { m.to_be_bytes() } else { m.to_le_bytes() });
        let message = image(START_NS, "camera", "32FC1", big_endian, 4 * W, &bytes.collect::<Vec<u8>>());
        let DepthImage::Metres(depth) = depth_of(IMAGE, &message, big_endian) else { panic!("32FC1 is in metres") };
        assert_eq!(depth.data(), metres);
    }
}

#[test]
fn compressed_depth_is_read() {
    let png = png_16(&values());
    let with_header = |a: f32, b: f32| [&0_i32.to_le_bytes()[..], &a.to_le_bytes(), &b.to_le_bytes(), &png].concat();
    for (format, data) in [
        ("16UC1; compressedDepth png", with_header(0.0, 0.0)),
        ("16UC1; compressedDepth", with_header(0.0, 0.0)),
        ("16UC1; png compressed", png.clone()),
        ("png", png.clone()),
    ] {
        let message = compressed(START_NS, "camera", format, &data);
        let DepthImage::Raw(depth) = depth_of(COMPRESSED, &message, false) else { panic!("{format} is raw") };
        assert_eq!(depth.data(), values());
    }
    let message = compressed(START_NS, "camera", "32FC1; compressedDepth png", &with_header(1500.0, 100.0));
    let DepthImage::Metres(depth) = depth_of(COMPRESSED, &message, false) else { panic!("in metres") };
    assert_eq!(depth[(0, 0)], 0.0, "0 means no measurement");
    assert_eq!(depth[(4, 2)], 1500.0 / (f32::from(depth_at(1, 4, 2)) - 100.0));
}

#[test]
fn colour_is_read_in_each_order_of_channels() {
    let channels: [(&str, &[usize]); 7] = [
        ("rgb8", &[0, 1, 2]),
        ("bgr8", &[2, 1, 0]),
        ("8UC3", &[2, 1, 0]),
        ("rgba8", &[0, 1, 2, 3]),
        ("bgra8", &[2, 1, 0, 3]),
        ("mono8", &[0]),
        ("8UC1", &[0]),
    ];
    let data: Vec<u8> = values().iter().flat_map(|value| value.to_le_bytes()).collect();
    let depth = image(START_NS, "camera", "16UC1", false, 2 * W, &data);
    for (encoding, order) in channels {
        let data: Vec<u8> = pixels().flat_map(|(x, y)| order.iter().map(move |&c| colour_at(2, x, y)[c])).collect();
        let colour = image(START_NS, "camera", encoding, false, order.len() as u32 * W, &data);
        let (_folder, path) = file((IMAGE, &depth), &INFO.message("camera", false), Some((IMAGE, &colour)));
        let read = open(&path).read(0).unwrap().colour.unwrap();
        let [r, g, b, _] = colour_at(2, 3, 4);
        let expected = if order.len() == 1 { [r, r, r, 255] } else { [r, g, b, 255] };
        assert_eq!(read[(3, 4)], expected, "{encoding}");
    }
    let mut jpeg = Cursor::new(Vec::new());
    DynamicImage::from(RgbImage::from_pixel(W, H, image::Rgb([200, 100, 50])))
        .write_to(&mut jpeg, ImageFormat::Jpeg)
        .unwrap();
    let colour = compressed(START_NS, "camera", "bgr8; jpeg compressed bgr8", &jpeg.into_inner());
    let (_folder, path) = file((IMAGE, &depth), &INFO.message("camera", false), Some((COMPRESSED, &colour)));
    let [r, g, b, a] = open(&path).read(0).unwrap().colour.unwrap()[(5, 5)];
    assert!(r.abs_diff(200) < 4 && g.abs_diff(100) < 4 && b.abs_diff(50) < 4 && a == 255);
}

#[test]
fn bad_images_are_named() {
    let info = INFO.message("camera", false);
    let data = vec![7; (2 * W * H) as usize];
    let failure = |message: &[u8]| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.mcap");
        let good = image(START_NS, "camera", "16UC1", false, 2 * W, &data);
        Mcap::create(&path)
            .put("/depth/image", IMAGE, START_NS, &good)
            .put("/depth/image", IMAGE, START_NS + 1, message)
            .put("/depth/camera_info", "sensor_msgs/CameraInfo", START_NS, &info)
            .finish();
        let mut recording = open(&path);
        assert!(recording.read(0).is_ok());
        recording.read(1).unwrap_err().to_string()
    };
    let cut_off = failure(&image(START_NS + 1, "camera", "16UC1", false, 2 * W, &data[..100]));
    assert!(cut_off.starts_with("frame 1: '"), "{cut_off}");
    let end = "frames.mcap', topic '/depth/image', message 1: 16x12 pixels need 384 bytes, but there are 100";
    assert!(cut_off.ends_with(end), "{cut_off}");
    let narrow = failure(&image(START_NS + 1, "camera", "16UC1", false, 30, &data));
    assert!(narrow.ends_with("rows of 16 pixels need 32 bytes, but the message has 30 for each"), "{narrow}");
    let eight_bit = failure(&image(START_NS + 1, "camera", "mono8", false, W, &data));
    assert!(eight_bit.ends_with("expected depth as 16UC1, mono16 or 32FC1, found mono8"), "{eight_bit}");
    let cdr = crate::files::Cdr::new(false).header(START_NS + 1, "camera").u32(H).u32(W + 1).string("16UC1");
    let wide = failure(&cdr.u8(0).u32(2 * W + 2).data(&data).finish());
    assert!(wide.ends_with("expected an image of 16x12 pixels as in the calibration, found 17x12"), "{wide}");
    let message = image(START_NS + 1, "camera", "16UC1", false, 2 * W, &data);
    let half = failure(&message[..message.len() / 2]);
    assert!(half.ends_with("message 1: the message is cut off"), "{half}");
}

#[test]
fn cameras_are_read_with_their_lenses() {
    let data: Vec<u8> = values().iter().flat_map(|value| value.to_le_bytes()).collect();
    let depth = image(START_NS, "camera", "16UC1", false, 2 * W, &data);
    let calibration = |info: &Info, big_endian| {
        let (_folder, path) = file((IMAGE, &depth), &info.message("camera", big_endian), None);
        let recording = open(&path);
        (recording.info().calibration.depth, recording.info().calibration.depth_distortion)
    };
    let lens = |model, d| calibration(&Info { model, d, ..INFO }, true).1;
    assert_eq!(lens("plumb_bob", &[0.1, 0.2, 0.01, 0.02]), Distortion::brown([0.1, 0.2, 0.01, 0.02, 0.0]));
    assert_eq!(lens("plumb_bob", &[0.0; 5]), Distortion::None);
    assert_eq!(lens("", &[]), Distortion::None);
    let eight = [0.1, 0.2, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06];
    assert_eq!(
        lens("rational_polynomial", &[0.1, 0.2, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06]),
        Distortion::rational(eight)
    );

    // Every second pixel of a part of a larger sensor.
    let part = Info { size: (64, 48), binning: 2, region: [4, 2, 2 * H, 2 * W], ..INFO };
    assert_eq!(calibration(&part, false).0, Intrinsics::new(W, H, 10.0, 10.5, 1.75, 1.75));

    let refused = |info: &Info| {
        let (_folder, path) = file((IMAGE, &depth), &info.message("camera", false), None);
        error(&path)
    };
    let fisheye = refused(&Info { model: "equidistant", d: &[0.1, 0.0, 0.0, 0.0], ..INFO });
    assert!(
        fisheye.contains("topic '/depth/camera_info': the lens model 'equidistant' with 4 coefficients"),
        "{fisheye}"
    );
    let no_fisheye_is_a_pinhole = refused(&Info { model: "equidistant", d: &[0.0; 4], ..INFO });
    assert!(no_fisheye_is_a_pinhole.contains("cannot be represented"), "{no_fisheye_is_a_pinhole}");
    let other_size = refused(&Info { size: (640, 480), ..INFO });
    assert!(other_size.contains("it describes images of 640x480 pixels, but they have 16x12"), "{other_size}");
}
