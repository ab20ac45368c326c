//! Stage `shrink` on the device, against its reference.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use common::Scene;
use glam::DVec3;
use itm_core::{ColourImage, Image};
use itm_gpu::shrink::Shrink;
use itm_gpu::{Recorder, reference};
use proptest::prelude::*;

proptest! {
    #![proptest_config(common::cases(12))]

    #[test]
    fn small_images_are_the_references(
        size in prop_oneof![Just((1u32, 1u32)), Just((160, 120)), (1..150u32, 1..120u32)],
        small in prop_oneof![Just((40u32, 30u32)), (1..50u32, 1..40u32)],
        sigma in prop_oneof![Just(0.0f32), Just(2.5), 0.1..5.0f32],
        holes in 0..9u32,
        with_colour: bool,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let pose = common::poses()[0];
        let hole = |x: u32, y: u32| (x * 7 + y * 13) % 9 < holes;
        let seen = Scene::room().depth(&camera, &pose);
        let depth = Image::from_fn(size.0, size.1, |x, y| if hole(x, y) { 0.0 } else { seen[(x, y)] });
        let painted = Scene::room().colour(&camera, &pose);
        let colour = ColourImage::from_fn(size.0, size.1, |x, y| if hole(y, x) { [0; 4] } else { painted[(x, y)] });
        let frame = common::frame(depth, with_colour.then(|| colour.clone()));
        let view = gpu.see(&common::one_camera(camera), &frame);
        let shrink = Shrink::new(&gpu.device, small, sigma, true);
        let mut recorder = Recorder::new(&gpu.device);
        let reader = shrink.record(&mut recorder, &view);
        let _untimed = recorder.submit();
        let (found, found_colour) = reader.read(&gpu.device).unwrap();

        let depth = view.read_depth(&gpu.device, 0).unwrap();
        let held = Image::from_fn(size.0, size.1, |x, y| {
            let z = f64::from(depth[(x, y)]);
            (z > 0.0).then(|| DVec3::new(z, 0.0, 0.0))
        });
        let expected = reference::shrink::shrink(&held, small, sigma.into());
        for (found, expected) in found.data().iter().zip(expected.data()) {
            let expected = expected.map_or(0.0, |value| value.x);
            // Some hundred additions of values of a few metres.
            prop_assert!((f64::from(*found) - expected).abs() < 2e-5, "{found} but {expected}");
        }
        prop_assert_eq!(found_colour.is_some(), with_colour);
        let Some(found) = found_colour else { return Ok(()) };
        let held = Image::from_fn(size.0, size.1, |x, y| {
            let [r, g, b, there] = colour[(x, y)].map(f64::from);
            (there > 0.0).then(|| DVec3::new(r, g, b) / 255.0)
        });
        let expected = reference::shrink::shrink(&held, small, sigma.into());
        for (found, expected) in found.data().iter().zip(expected.data()) {
            let [r, g, b, there] = found.map(f64::from);
            prop_assert_eq!(there > 0.0, expected.is_some());
            // Half a step for rounding to bytes.
            let off = (DVec3::new(r, g, b) / 255.0 - expected.unwrap_or_default()).abs().max_element();
            prop_assert!(off < 0.51 / 255.0, "{found:?} but {expected:?}");
        }
    }
}
