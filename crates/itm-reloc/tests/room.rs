//! Ferns in a furnished room, seen by casting rays.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

use glam::{DQuat, DVec3};
use itm_core::{Image, Intrinsics, RelocaliserSettings, Se3, Settings, Timestamp};
use itm_reloc::{Ferns, Relocaliser as _, SmallView, average_pose};

/// The room's lowest and highest corner in metres; y points down. No two walls are equally far from the middle of the way.
const ROOM: [DVec3; 2] = [DVec3::new(-1.4, -1.25, -3.4), DVec3::new(2.9, 1.25, 2.0)];

/// Furniture: lowest and highest corner.
const BOXES: [[DVec3; 2]; 5] = [
    [DVec3::new(-1.4, 0.4, -1.0), DVec3::new(-0.9, 1.25, 0.8)],
    [DVec3::new(2.0, -0.9, 0.6), DVec3::new(2.9, 1.25, 2.0)],
    [DVec3::new(-0.4, 0.5, 1.2), DVec3::new(0.9, 1.25, 2.0)],
    [DVec3::new(0.3, 0.1, -3.0), DVec3::new(1.1, 1.25, -2.0)],
    [DVec3::new(-1.4, -1.25, -2.8), DVec3::new(-0.7, 1.25, -1.8)],
];

/// Where a ray enters and leaves a box, as multiples of its direction.
fn slabs(from: DVec3, direction: DVec3, [low, high]: [DVec3; 2]) -> (f64, f64) {
    let (a, b) = ((low - from) / direction, (high - from) / direction);
    (a.min(b).max_element(), a.max(b).min_element())
}

/// Depth along the optical axis, for a direction whose part along it is 1.
fn depth(from: DVec3, direction: DVec3) -> f64 {
    let (_, wall) = slabs(from, direction, ROOM);
    let entries = BOXES.iter().map(|corners| slabs(from, direction, *corners));
    entries.filter(|(enter, leave)| 0.0 < *enter && enter < leave).fold(wall, |nearest, (enter, _)| nearest.min(enter))
}

/// Standard deviation of the Gaussian, in pixels.
const SMOOTHING_PX: f64 = 2.5;

/// What a camera of 40x30 pixels sees, smoothed by a Gaussian, with nothing beyond 4 m.
fn view(room_from_camera: &Se3) -> SmallView {
    let raw = Image::from_fn(40, 30, |x, y| {
        let direction = DVec3::new((f64::from(x) - 19.5) / 33.0, (f64::from(y) - 14.5) / 33.0, 1.0);
        let depth = depth(room_from_camera.translation, room_from_camera.transform_vector(direction));
        if depth < 4.0 { depth } else { 0.0 }
    });
    // Along rows, then columns; what has no depth takes no part.
    let smoothed = |image: &Image<f64>, (dx, dy): (i64, i64)| {
        Image::from_fn(40, 30, |x, y| {
            let (mut sum, mut weights) = (0.0, 0.0);
            for step in -6..=6i64 {
                let at = (i64::from(x) + dx * step, i64::from(y) + dy * step);
                let (Ok(x), Ok(y)) = (u32::try_from(at.0), u32::try_from(at.1)) else { continue };
                if let Some(depth) = image.get(x, y).filter(|depth| **depth > 0.0) {
                    let weight = (-0.5 * (step as f64 / SMOOTHING_PX).powi(2)).exp();
                    sum += weight * depth;
                    weights += weight;
                }
            }
            if weights > 0.0 { sum / weights } else { 0.0 }
        })
    };
    let smooth = smoothed(&smoothed(&raw, (1, 0)), (0, 1));
    let depth = smooth.data().iter().map(|depth| *depth as f32).collect();
    SmallView::new(Image::new(40, 30, depth).unwrap(), None).unwrap()
}

/// A camera that looks outwards on its way around the room, up and down a little: `turn` from 0 to 1.
fn on_the_way(turn: f64) -> Se3 {
    let angle = std::f64::consts::TAU * turn;
    let tilt = DQuat::from_rotation_x(0.15 * (3.0 * angle).sin());
    Se3::new(DQuat::from_rotation_y(angle) * tilt, DVec3::new(0.5 * angle.sin(), -0.2, 0.6 * angle.cos()))
}

/// Keyframes harvested on the way.
fn walked(settings: &RelocaliserSettings) -> Ferns {
    let relocaliser = settings.clone();
    let mut ferns = Ferns::new(&Settings { relocaliser, ..Settings::default() }).unwrap();
    for frame in 0..300 {
        let pose = on_the_way(f64::from(frame) / 300.0);
        ferns.harvest(&view(&pose), 0, &pose, Timestamp(i64::from(frame))).unwrap();
    }
    ferns
}

fn is_near(a: &Se3, b: &Se3) -> bool {
    let between = a.inverse() * *b;
    between.translation.length() < 0.5 && between.angle() < 0.5
}

/// The report's settings for one map, and those for closing loops.
fn both_settings() -> [RelocaliserSettings; 2] {
    let loops = RelocaliserSettings { ferns: 1000, min_dissimilarity: 0.1, ..RelocaliserSettings::default() };
    [RelocaliserSettings { ferns: 500, min_dissimilarity: 0.2, ..loops.clone() }, loops]
}

#[test]
fn a_way_leaves_keyframes_here_and_there() {
    let [few, many] = both_settings().map(|settings| walked(&settings).keyframes().len());
    assert!((15..60).contains(&few) && (few + 20..150).contains(&many), "{few} and {many} of 300");
}

#[test]
fn views_near_the_way_find_it() {
    for (settings, at_least) in both_settings().into_iter().zip([90, 99]) {
        let ferns = walked(&settings);
        let (mut nearest, mut mean) = (0, 0);
        for query in 0..100 {
            let beside = Se3::exp([0.05, -0.03, 0.04, 0.03, 0.02, 0.04]);
            let pose = on_the_way((f64::from(query) + 0.5) / 100.0) * beside;
            let found = ferns.candidates(&view(&pose), settings.candidates as usize, &|_| true).unwrap();
            nearest += u32::from(is_near(&pose, &found[0].keyframe.submap_from_camera));
            mean += u32::from(is_near(&pose, &average_pose(&found, &settings).unwrap().submap_from_camera));
        }
        assert!(nearest >= at_least && mean >= at_least, "{nearest} nearest and {mean} mean poses of 100 are near");
    }
}

/// The most similar keyframe leads to where the camera is where the view is taken to where the keyframe is, and not as it is.
#[test]
fn views_from_further_back_are_found_by_what_they_would_be_ahead() {
    let ferns = walked(&RelocaliserSettings::default());
    let camera = Intrinsics::new(40, 30, 33.0, 33.0, 19.5, 14.5);
    let ahead = Se3::exp([0.0, 0.0, 0.6, 0.0, 0.0, 0.0]);
    let (mut as_it_is, mut taken_ahead) = (0, 0);
    for query in 0..50 {
        let pose = on_the_way((f64::from(query) + 0.5) / 50.0) * ahead.inverse();
        let here = view(&pose);
        let there = here.seen_from(&camera, &ahead);
        let found = |view| ferns.candidates(view, 1, &|_| true).unwrap()[0].keyframe.submap_from_camera;
        as_it_is += u32::from(is_near(&(pose * ahead), &found(&here)));
        taken_ahead += u32::from(is_near(&(pose * ahead), &found(&there)));
    }
    assert!(taken_ahead >= 45 && as_it_is + 10 <= taken_ahead, "{as_it_is} as they are, {taken_ahead} ahead, of 50");
}

#[test]
fn views_from_elsewhere_resemble_no_keyframe() {
    let looking = |yaw: f64, pitch: f64, x: f64, y: f64, z: f64| {
        Se3::new(DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch), DVec3::new(x, y, z))
    };
    for settings in both_settings() {
        let ferns = walked(&settings);
        for (what, pose) in [
            ("before a wall", looking(1.57, 0.0, 2.5, 0.0, -1.0)),
            ("across the room from a corner", looking(-0.6, -0.4, 2.6, -1.0, -3.1)),
            ("over the floor", looking(2.0, -0.9, 2.0, 0.9, 0.0)),
        ] {
            let found = ferns.candidates(&view(&pose), 1, &|_| true).unwrap();
            let dissimilarity = found.first().map_or(1.0, |found| found.dissimilarity);
            assert!(dissimilarity > 0.25, "{what}: {dissimilarity}");
        }
    }
}
