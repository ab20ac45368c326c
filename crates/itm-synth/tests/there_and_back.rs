//! Recordings that go back the way they came.

use glam::DVec3;
use itm_core::{DepthImage, Frame, Image, Se3};
use itm_synth::{Cover, DepthNoise, Exposure, Path, Sequence, Spec};

fn metres(frame: &Frame) -> &Image<f32> {
    let DepthImage::Metres(depth) = &frame.depth else { panic!("metres") };
    depth
}

#[test]
fn every_path_comes_back_as_it_went() {
    for path in Path::ALL {
        let there = Spec::new(path).with_size(8, 6).with_frames(50);
        let (there, both) = (Sequence::new(there).unwrap(), Sequence::new(there.there_and_back()).unwrap());
        assert_eq!(both.spec().frames, 99);
        for i in 0..99 {
            let apart = there.world_from_camera(i.min(98 - i)).inverse() * both.world_from_camera(i);
            assert!(apart.translation.length() < 1e-9 && apart.angle() < 1e-9, "{path}, frame {i}");
            assert!(i == 0 || both.timestamp(i) > both.timestamp(i - 1));
        }
    }
}

#[test]
fn the_way_back_has_noise_of_its_own_on_what_was_seen_before() {
    let exact = Spec::new(Path::Loop).with_size(40, 30).with_frames(5).there_and_back();
    let noisy = exact.with_noise(DepthNoise::KINECT, 3);
    let (exact, noisy) = (Sequence::new(exact).unwrap(), Sequence::new(noisy).unwrap());
    let (first, last) = (exact.frame(0), exact.frame(8));
    assert!(metres(&first).data().iter().zip(metres(&last).data()).all(|(a, b)| (a - b).abs() < 1e-4));
    let (first, last) = (noisy.frame(0), noisy.frame(8));
    let different = metres(&first).data().iter().zip(metres(&last).data()).filter(|(a, b)| a != b).count();
    assert!(different > 400, "{different} of 1200 pixels");
}

#[test]
fn a_cover_comes_again_and_exposure_goes_on() {
    let spec = Spec { exposure: Some(Exposure::AUTO), cover: Some(Cover::GRADUALLY), ..Spec::new(Path::Arc) };
    let sequence = Sequence::new(spec.there_and_back()).unwrap();
    for i in 0..119 {
        assert!((sequence.covered_share(i) - sequence.covered_share(118 - i)).abs() < 1e-9, "frame {i}");
    }
    assert!(sequence.covered_share(33) == 1.0 && sequence.covered_share(118) == 0.0);
    assert_ne!(sequence.brightness(10), sequence.brightness(108));
}

#[test]
fn colour_taken_later_is_seen_from_where_the_camera_is_then() {
    let at_once = Spec::new(Path::Loop).with_size(40, 30).with_frames(10).there_and_back();
    let delayed = Spec { colour_delay_s: 1.0 / 30.0, ..at_once };
    let (at_once, delayed) = (Sequence::new(at_once).unwrap(), Sequence::new(delayed).unwrap());
    let (later, same) = (delayed.frame(14).colour.unwrap(), at_once.frame(15).colour.unwrap());
    let different = later.data().iter().zip(same.data()).filter(|(a, b)| a != b).count();
    assert!(different < 12, "{different} pixels");
}

#[test]
fn turning_rates_lead_back_to_the_start() {
    let spec = Spec { inertial_rate_hz: 1000.0, ..Spec::new(Path::Fast).with_size(8, 6).with_frames(60) };
    let sequence = Sequence::new(spec.there_and_back()).unwrap();
    let mut pose = sequence.world_from_camera(0);
    let mut farthest = 0.0f64;
    for reading in sequence.inertial() {
        let DVec3 { x, y, z } = reading.gyroscope * 1e-3;
        pose = pose * Se3::exp([0.0, 0.0, 0.0, x, y, z]);
        farthest = farthest.max((sequence.world_from_camera(0).inverse() * pose).angle());
    }
    let left = (pose.inverse() * sequence.world_from_camera(0)).angle();
    assert!(farthest > 0.5 && left < 4e-3, "{farthest} rad away, {left} rad off in the end");
}
