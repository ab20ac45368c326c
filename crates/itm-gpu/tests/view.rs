//! Stage `view` on the device against its reference.

mod common;

use glam::{DVec2, DVec3};
use itm_core::{
    Calibration, ColourImage, DepthConversion, DepthImage, Distortion, Frame, Image, Intrinsics, Se3, Timestamp,
};
use itm_gpu::view::{ViewOptions, ViewStage};
use itm_gpu::{Device, Error, Recorder, View, reference};
use proptest::prelude::*;

const RANGE_M: [f32; 2] = [0.3, 4.0];
/// What the stage takes for a depth edge, in metres.
const EDGE_M: f32 = 0.1;

const OPTIONS: ViewOptions = ViewOptions {
    depth_range_m: RANGE_M,
    bilateral_passes: 0,
    levels: 5,
    vertices: Some(1),
    observation_weights: true,
    colour_levels: 4,
};

fn run(device: &Device, calibration: &Calibration, frame: &Frame, options: &ViewOptions) -> View {
    let mut view = View::new(device, calibration, options);
    let mut recorder = Recorder::new(device);
    ViewStage::new(device).record(&mut recorder, &mut view, frame, options).expect("the sizes are right");
    let _untimed = recorder.submit();
    view
}

fn assert_close(found: &Image<f32>, expected: &Image<f32>, tolerance: f32) -> Result<(), TestCaseError> {
    prop_assert_eq!(found.size(), expected.size());
    for (i, (a, b)) in found.data().iter().zip(expected.data()).enumerate() {
        prop_assert!((a - b).abs() <= tolerance, "value {i}: {a} but {b}");
    }
    Ok(())
}

/// Random sizes, with those that are odd in some way drawn often.
fn size() -> impl Strategy<Value = (u32, u32)> {
    prop_oneof![Just((1, 1)), Just((81, 61)), Just((2, 33)), (1..100u32, 1..80u32)]
}

/// Wavy surfaces with jumps, holes and millimetres of noise, from a few random numbers.
fn depth_image((width, height): (u32, u32), seed: [u32; 4]) -> Image<f32> {
    let [a, b, c, d] = seed.map(|s| s as f32 / u32::MAX as f32);
    Image::from_fn(width, height, |x, y| {
        let hash = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed[0]).wrapping_mul(0xc2b2_ae35) >> 8;
        if hash.is_multiple_of(11) {
            return 0.0;
        }
        let noise = (hash % 1000) as f32 * 4e-6;
        let (u, v) = (x as f32 * 0.05, y as f32 * 0.05);
        let jump = if (u * a + v * b).sin() > 0.3 { 0.8 } else { 0.0 };
        0.6 + 2.0 * a + 0.1 * (u + 6.0 * c).sin() * (v + 6.0 * d).cos() + jump + noise
    })
}

fn camera((width, height): (u32, u32), negative_fy: bool) -> Intrinsics {
    let camera = common::camera(width, height);
    if negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera }
}

proptest! {
    #![proptest_config(common::cases(16))]

    #[test]
    fn raw_depth_becomes_metres(
        size in size(),
        seed in any::<u32>(),
        conversion in prop_oneof![
            Just(DepthConversion::MILLIMETRES),
            Just(DepthConversion::TUM),
            Just(DepthConversion::Affine { scale: 0.00125, offset: -0.031 }),
            Just(DepthConversion::Disparity { a: 1135.09, b: 0.0819141 }),
        ],
    ) {
        let Some(device) = common::device() else { return Ok(()) };
        let calibration = Calibration::registered(camera(size, false), conversion);
        let focal_x = calibration.depth.fx;
        let raw = Image::from_fn(size.0, size.1, |x, y| {
            let value = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed).wrapping_mul(0xc2b2_ae35) >> 8;
            // All values, those that mean something among them often.
            match value % 4 {
                0 => (value >> 4) as u16,
                1 => [0, 65_535][(value >> 4) as usize % 2],
                _ => 300 + (value >> 4) as u16 % 4000,
            }
        });
        let everything = reference::view::convert_depth(&raw, conversion, focal_x, [f32::MIN, f32::MAX]);
        let frame = Frame::new(0, Timestamp(0), DepthImage::Raw(raw), None);
        let view = run(device, &calibration, &frame, &OPTIONS);
        let metres = view.read_depth(device, 0).unwrap();
        for (found, exact) in metres.data().iter().zip(everything.data()) {
            // Single precision: a few relative roundings of 6e-8 each. In `b / (a - raw)` also `a` is rounded, by up to
            // 6.1e-5 for numbers between 1024 and 2048.
            let tolerance = 5e-7 * exact.abs()
                + match conversion {
                    DepthConversion::Affine { .. } => 0.0,
                    DepthConversion::Disparity { b, .. } => 6.5e-5 * exact * exact / (8.0 * b * focal_x) as f32,
                };
            if *found == 0.0 {
                prop_assert!(!(RANGE_M[0] + tolerance..RANGE_M[1] - tolerance).contains(exact), "{exact} was dropped");
            } else {
                prop_assert!((found - exact).abs() <= tolerance, "{found} but {exact}");
                prop_assert!((RANGE_M[0]..=RANGE_M[1]).contains(found));
            }
        }
    }

    #[test]
    fn depth_is_smoothed_and_halved_and_given_vertices(
        size in size(), seed in any::<[u32; 4]>(), negative_fy: bool, passes in 1..4u32,
    ) {
        let Some(device) = common::device() else { return Ok(()) };
        let calibration = Calibration::registered(camera(size, negative_fy), DepthConversion::MILLIMETRES);
        let frame = common::frame(depth_image(size, seed), None);
        let view = run(device, &calibration, &frame, &OPTIONS);
        let mut depth = view.read_depth(device, 0).unwrap();
        let DepthImage::Metres(metres) = &frame.depth else { unreachable!("made of metres") };
        // Nothing is computed here, so nothing may differ.
        prop_assert_eq!(&depth, &reference::view::clip_depth(metres, RANGE_M));

        check_vertices(&view.read_vertices(device).unwrap().unwrap(), &depth, &calibration.depth)?;
        let observations = view.read_observations(device).unwrap().unwrap();
        let weights = reference::view::observation_weights(&depth, &calibration.depth, EDGE_M);
        for ((z, [seen, weight]), expected) in depth.data().iter().zip(observations.data()).zip(weights.data()) {
            prop_assert_eq!(z, seen);
            // Rounded to whole numbers. Differences of positions between pixels a few millimetres apart carry a relative
            // 1e-4 of rounding.
            prop_assert!((f64::from(*weight) - expected).abs() <= 0.5 + 16.0 * 1e-3, "{weight} but {expected} at {z} m");
            prop_assert!(weight.fract() == 0.0 && (1.0..=16.0).contains(weight));
        }

        for level in 1..OPTIONS.levels {
            let halved = view.read_depth(device, level).unwrap();
            let camera = view.level_camera(level);
            prop_assert_eq!(halved.size(), (camera.width, camera.height));
            // A sum of four and its quotient: four roundings of up to 16 m.
            assert_close(&halved, &reference::view::halve_depth(&depth, EDGE_M), 4.0 * 16.0 * 6e-8)?;
            depth = halved;
        }

        let smoothed = run(device, &calibration, &frame, &ViewOptions { bilateral_passes: passes, ..OPTIONS });
        let mut expected = reference::view::clip_depth(metres, RANGE_M);
        for _ in 0..passes {
            expected = reference::view::bilateral(&expected);
        }
        // A pass sums 25 values of up to 4 m, each rounded; errors of exp (Vulkan allows a relative 2e-7 (3 + 2 |x|))
        // count only by how far values that still have a weight lie apart, some centimetres.
        assert_close(&smoothed.read_depth(device, 0).unwrap(), &expected, passes as f32 * 3e-6)?;
    }

    #[test]
    fn colour_gets_a_pyramid(size in size(), seed in any::<u32>()) {
        let Some(device) = common::device() else { return Ok(()) };
        // Colour of another size than depth.
        let calibration = Calibration {
            depth: camera((7, 5), false),
            ..Calibration::registered(camera(size, false), DepthConversion::MILLIMETRES)
        };
        let colour = ColourImage::from_fn(size.0, size.1, |x, y| {
            let value = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed).wrapping_mul(0xc2b2_ae35);
            let [r, g, b, a] = value.to_le_bytes();
            [r, g, b, if a < 20 { 0 } else { 255 }]
        });
        let mut expected = colour.clone();
        let view = run(device, &calibration, &common::frame(Image::filled(7, 5, 1.0), Some(colour)), &OPTIONS);
        for level in 0..OPTIONS.colour_levels {
            let found = view.read_colour(device, level).unwrap().unwrap();
            prop_assert_eq!(found.size(), expected.size());
            for (a, b) in found.data().iter().zip(expected.data()) {
                // A mean that lies halfway between two bytes may be rounded to either.
                prop_assert!((0..4).all(|c| a[c].abs_diff(b[c]) <= u8::from(level > 0)), "{a:?} but {b:?}");
            }
            expected = reference::view::halve_colour(&found);
        }
    }
}

/// Lenses that are mild enough for no image of the test's cameras to fold over.
fn lens() -> impl Strategy<Value = Distortion> {
    prop_oneof![
        (prop::array::uniform3(-0.04..0.04f64), prop::array::uniform2(-0.01..0.01f64))
            .prop_map(|([k1, k2, k3], [p1, p2])| Distortion::brown([k1, k2, p1, p2, k3])),
        (prop::array::uniform6(-0.04..0.04f64), prop::array::uniform2(-0.01..0.01f64))
            .prop_map(|([k1, k2, k3, k4, k5, k6], [p1, p2])| Distortion::rational([k1, k2, p1, p2, k3, k4, k5, k6])),
    ]
}

proptest! {
    #![proptest_config(common::cases(16))]

    #[test]
    fn lenses_are_undone_as_the_reference_does(
        size in size(),
        seed in any::<[u32; 4]>(),
        (depth_lens, colour_lens) in (lens(), lens()),
        negative_fy: bool,
        passes in 0..3u32,
    ) {
        /// How far single precision may move the place that a pixel is taken from.
        const MARGIN_PX: f64 = 1e-3;
        let Some(device) = common::device() else { return Ok(()) };
        // The principal point within the pixels' centres: elsewhere an image of one pixel would reach too far to a side.
        let centred = |c: Intrinsics| {
            Intrinsics { cx: 0.49 * f64::from(c.width - 1), cy: 0.52 * f64::from(c.height - 1), ..c }
        };
        let depth_camera = centred(camera(size, negative_fy));
        let colour_camera = centred(camera((size.1 + 3, size.0), false));
        let calibration = Calibration {
            colour: colour_camera,
            depth_distortion: depth_lens,
            colour_distortion: colour_lens,
            ..Calibration::registered(depth_camera, DepthConversion::MILLIMETRES)
        };
        prop_assert_eq!(calibration.validate(), Ok(()));
        let colour = ColourImage::from_fn(colour_camera.width, colour_camera.height, |x, y| {
            let wave = |a: f64, b: f64| (127.5 + 127.4 * (a * f64::from(x) + b * f64::from(y)).sin()) as u8;
            // Some have no colour.
            let hash = (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77) ^ seed[3]).wrapping_mul(0xc2b2_ae35) >> 8;
            [wave(0.31, 0.12), wave(-0.07, 0.4), wave(0.5, -0.5), if hash.is_multiple_of(40) { 0 } else { 255 }]
        });
        let frame = common::frame(depth_image(size, seed), Some(colour.clone()));
        let view = run(device, &calibration, &frame, &OPTIONS);

        let DepthImage::Metres(metres) = &frame.depth else { unreachable!("made of metres") };
        let clipped = reference::view::clip_depth(metres, RANGE_M);
        let undistorted = reference::view::undistort_depth(&clipped, &depth_camera, &depth_lens);
        let depth = view.read_depth(device, 0).unwrap();
        let near = |v: f64, at: f64| (v - at).abs() < MARGIN_PX;
        let near_integer = |v: f64| near(v, v.round());
        for y in 0..size.1 {
            for x in 0..size.0 {
                let source = depth_lens.distort_pixel(&depth_camera, DVec2::new(x.into(), y.into()));
                // Between two pixels either is as near.
                let border = near_integer(source.x + 0.5) || near_integer(source.y + 0.5);
                prop_assert!(border || depth[(x, y)] == undistorted[(x, y)], "({x}, {y}) from {source}");
            }
        }

        let expected = reference::view::undistort_colour(&colour, &colour_camera, &colour_lens);
        let found = view.read_colour(device, 0).unwrap().expect("the frame has colour");
        for y in 0..colour_camera.height {
            for x in 0..colour_camera.width {
                let (a, b) = (found[(x, y)], expected[(x, y)]);
                // A step of a byte: interpolated colours are rounded.
                if a[3] == b[3] && a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 1) {
                    continue;
                }
                let source = colour_lens.distort_pixel(&colour_camera, DVec2::new(x.into(), y.into()));
                let ends = |v: f64, size: u32| near_integer(v) || near(v, -0.5) || near(v, f64::from(size) - 0.5);
                let border = ends(source.x, colour_camera.width) || ends(source.y, colour_camera.height);
                prop_assert!(border, "({x}, {y}) from {source}: {a:?} but {b:?}");
            }
        }
        // What follows is made from the undistorted images, whatever number of passes comes between.
        let halved = view.read_colour(device, 1).unwrap().expect("the frame has colour");
        for (a, b) in halved.data().iter().zip(reference::view::halve_colour(&found).data()) {
            prop_assert_eq!(a[3], b[3], "no colour where a pixel of the group has none");
        }
        let smoothed = run(device, &calibration, &frame, &ViewOptions { bilateral_passes: passes, ..OPTIONS });
        let mut expected = depth;
        for _ in 0..passes {
            expected = reference::view::bilateral(&expected);
        }
        assert_close(&smoothed.read_depth(device, 0).unwrap(), &expected, passes as f32 * 3e-6)?;
    }
}

/// What a lens shows of a tilted wall and of a pattern comes back as a pinhole camera would have seen it.
#[test]
fn a_wall_seen_through_a_lens_is_seen_as_by_a_pinhole_camera() {
    let Some(device) = common::device() else { return };
    // TUM RGB-D's first Kinect, at a quarter of its size.
    let camera = Intrinsics::new(640, 480, 517.3, 516.5, 318.6, 255.3).scaled_to(160, 120);
    let lens = Distortion::brown([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
    let wall = DVec3::new(0.25, -0.1, 1.0);
    // z from wall · (ray z) = 1.6.
    let depth_at = |pixel: DVec2| 1.6 / wall.dot(camera.unproject(pixel, 1.0));
    let colour_at = |pixel: DVec2| {
        let wave = |a: f64, b: f64| 127.5 + 120.0 * (a * pixel.x + b * pixel.y).sin();
        DVec3::new(wave(0.2, 0.03), wave(-0.05, 0.22), wave(0.12, 0.12))
    };
    let shown = |x: u32, y: u32| {
        let focal = DVec2::new(camera.fx, camera.fy);
        let point = camera.unproject(DVec2::new(x.into(), y.into()), 1.0).truncate();
        lens.undistort(point).expect("within the lens's reach") * focal + DVec2::new(camera.cx, camera.cy)
    };
    let depth = Image::from_fn(160, 120, |x, y| depth_at(shown(x, y)) as f32);
    let colour = ColourImage::from_fn(160, 120, |x, y| {
        let [r, g, b] = colour_at(shown(x, y)).round().to_array().map(|v| v as u8);
        [r, g, b, 255]
    });
    let calibration = Calibration {
        depth_distortion: lens,
        colour_distortion: lens,
        ..Calibration::registered(camera, DepthConversion::MILLIMETRES)
    };
    let view = run(device, &calibration, &common::frame(depth, Some(colour)), &OPTIONS);
    let (depth, colour) = (view.read_depth(device, 0).unwrap(), view.read_colour(device, 0).unwrap().unwrap());
    let (mut missing, mut worst_depth, mut worst_colour) = (0, 0.0_f64, 0.0_f64);
    for y in 0..120 {
        for x in 0..160 {
            let pixel = DVec2::new(x.into(), y.into());
            if colour[(x, y)][3] == 0 {
                assert_eq!(depth[(x, y)], 0.0, "registered images have the same border");
                missing += 1;
                continue;
            }
            worst_depth = worst_depth.max((f64::from(depth[(x, y)]) - depth_at(pixel)).abs());
            // The outer half of the outermost pixels has nothing to be interpolated with.
            let source = lens.distort_pixel(&camera, pixel);
            if source.min_element() < 0.0 || source.x > 159.0 || source.y > 119.0 {
                continue;
            }
            for (found, expected) in colour[(x, y)].iter().zip(colour_at(pixel).to_array()) {
                worst_colour = worst_colour.max((f64::from(*found) - expected).abs());
            }
        }
    }
    // The nearest pixel lies up to half a pixel away in x and y: of a slope of at most 0.25 z² / (1.6 f) a pixel.
    assert!(worst_depth < 0.006, "{worst_depth} m");
    // Bilinear interpolation of a sine: 120 · 0.23² / 8 along each axis, and two roundings.
    assert!(worst_colour < 3.0, "{worst_colour} steps");
    assert!((100..2000).contains(&missing), "{missing} pixels lie beyond the lens's image");
    let pinhole = Calibration::registered(camera, DepthConversion::MILLIMETRES);
    let plain = run(device, &pinhole, &common::frame(depth.clone(), None), &OPTIONS);
    assert_eq!(plain.read_depth(device, 0).unwrap(), depth, "without a lens nothing moves");
}

/// Vertices and normals against the reference's, for the depth that they were made of.
fn check_vertices(
    (vertices, normals): &(Image<[f32; 4]>, Image<[f32; 4]>),
    depth: &Image<f32>,
    camera: &Intrinsics,
) -> Result<(), TestCaseError> {
    let expected = reference::view::vertices(depth, camera, EDGE_M, OPTIONS.vertices.unwrap_or(1));
    for (i, expected) in expected.data().iter().enumerate() {
        let [x, y, z, w] = vertices.data()[i].map(f64::from);
        let [nx, ny, nz, nw] = normals.data()[i].map(f64::from);
        let Some(expected) = expected else {
            prop_assert_eq!([x, y, z, w, nx, ny, nz, nw], [0.0; 8]);
            continue;
        };
        prop_assert_eq!(w, 1.0);
        // A handful of relative roundings of 6e-8 each.
        let vertex = DVec3::new(x, y, z);
        let tolerance = 4e-7 * expected.position.length();
        prop_assert!(vertex.abs_diff_eq(expected.position, tolerance), "{vertex} but {}", expected.position);
        let normal = DVec3::new(nx, ny, nz);
        match expected.normal {
            None => prop_assert_eq!([nx, ny, nz, nw], [0.0; 4]),
            Some(exact) => {
                prop_assert_eq!(nw, 1.0);
                // Neighbours are two pixels apart, at least 2 z / f sideways, and uncertain by 4e-7 z each; their
                // difference's direction thus by 4e-7 f. A jump in depth of up to 2 * 0.1 m between them, 12 to 100
                // times the step sideways, makes the two differences nearly parallel, and their product that much
                // less certain.
                prop_assert!(normal.abs_diff_eq(exact, 4e-7 * camera.fx * 100.0), "{normal} but {exact}");
            }
        }
    }
    Ok(())
}

#[test]
fn what_is_no_depth_is_dropped() {
    let Some(device) = common::device() else { return };
    let calibration = Calibration::registered(camera((7, 1), false), DepthConversion::MILLIMETRES);
    let metres = vec![f32::NAN, f32::INFINITY, -1.0, 0.0, RANGE_M[0], RANGE_M[1], RANGE_M[1].next_up()];
    let frame = common::frame(Image::new(7, 1, metres).unwrap(), None);
    let options = ViewOptions { levels: 1, vertices: None, colour_levels: 1, ..OPTIONS };
    let view = run(device, &calibration, &frame, &options);
    let found = view.read_depth(device, 0).unwrap();
    assert_eq!(found.data(), &[0.0, 0.0, 0.0, 0.0, RANGE_M[0], RANGE_M[1], 0.0]);
}

#[test]
fn images_of_the_wrong_size_are_refused() {
    let Some(device) = common::device() else { return };
    let calibration = Calibration::registered(camera((8, 6), false), DepthConversion::MILLIMETRES);
    let mut view = View::new(device, &calibration, &OPTIONS);
    let stage = ViewStage::new(device);
    let mut record = |frame: &Frame| stage.record(&mut Recorder::new(device), &mut view, frame, &OPTIONS);
    let error = record(&common::frame(Image::filled(8, 7, 1.0), None)).unwrap_err();
    assert!(matches!(error, Error::ImageSize { image: "depth", found: (8, 7), expected: (8, 6) }), "{error}");
    let colour = ColourImage::filled(7, 6, [0; 4]);
    let error = record(&common::frame(Image::filled(8, 6, 1.0), Some(colour))).unwrap_err();
    assert!(matches!(error, Error::ImageSize { image: "colour", .. }), "{error}");
}

#[test]
fn a_large_image_goes_through_in_one_piece() {
    let Some(device) = common::device() else { return };
    let camera = common::camera(1280, 1024);
    let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
    let depth = common::Scene::room().depth(&camera, &Se3::IDENTITY);
    let frame = common::frame(depth.clone(), Some(common::colours(&camera)));
    let view = run(device, &calibration, &frame, &OPTIONS);
    assert_eq!(view.read_depth(device, 0).unwrap(), reference::view::clip_depth(&depth, RANGE_M));
    let coarse = view.read_depth(device, 4).unwrap();
    assert_eq!(coarse.size(), (80, 64));
    assert!(coarse.data().iter().all(|z| *z > 0.0), "every ray meets the room");
}
