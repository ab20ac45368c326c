//! How often a camera is found in a map by its keyframes: a table of recordings that were mapped and of frames that were not.
//!
//! `cargo run --release --package itm-tests --example relocalise`. A frame counts as found where the pose is within 5 cm and 5
//! degrees of the truth; beside it how often the pose of the most similar keyframe would have been, and how often a
//! pose was taken for right that is not. The kitchen (`ITM_TEST_DATA`) is mapped from its even frames at their true poses, and
//! asked for its odd ones.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program of the developers'")]

use std::time::Instant;

use itm_io::recording::{OpenOptions, Recording, open};
use itm_slam::{Device, Frame, Poses, Se3, Settings, Slam};
use itm_synth::{DepthNoise, Path, Sequence, Spec};
use itm_tests::InMemory;

fn near(a: &Se3, b: &Se3) -> bool {
    let off = a.inverse() * *b;
    off.translation.length() <= 0.05 && off.angle().to_degrees() <= 5.0
}

fn row(name: &str, slam: &mut Slam, queries: impl Iterator<Item = Frame>) {
    let (mut asked, mut found, mut wrong, mut nearest_right) = (0, 0, 0, 0);
    let mut times = Vec::new();
    for frame in queries {
        let Some(truth) = frame.world_from_camera else { continue };
        let started = Instant::now();
        let sighting = slam.find(&frame).unwrap();
        if std::env::var_os("RELOC_DEBUG").is_some() {
            for keyframe in slam.keyframes() {
                let off = keyframe.submap_from_camera.inverse() * truth;
                println!("  {}: {:.2} m {:.0} deg", keyframe.id, off.translation.length(), off.angle().to_degrees());
            }
        }
        times.push(started.elapsed().as_secs_f64() * 1e3);
        asked += 1;
        if let Some((_, tracked)) = sighting.found {
            let right = near(&tracked.world_from_camera, &truth);
            found += usize::from(right);
            wrong += usize::from(!right);
        }
        nearest_right +=
            usize::from(sighting.resembles.is_some_and(|keyframe| near(&keyframe.submap_from_camera, &truth)));
    }
    times.sort_by(f64::total_cmp);
    let percent = |n: usize| 100.0 * n as f64 / asked as f64;
    println!(
        "| {name} | {} | {asked} | {:.1} | {:.1} | {:.1} | {:.0} |",
        slam.keyframes().len(),
        percent(nearest_right),
        percent(found),
        percent(wrong),
        times[times.len() / 2]
    );
}

fn synthetic(path: Path, seed: u64, frames: u32) -> InMemory {
    let spec = Spec::new(path).with_size(320, 240).with_noise(DepthNoise::KINECT, seed).with_frames(frames);
    InMemory::new(Sequence::new(spec).unwrap())
}

fn main() {
    let device = Device::open("auto").unwrap();
    let mut settings = Settings::resolve(None, &std::env::args().skip(1).collect::<Vec<_>>()).unwrap();
    println!("| mapped; asked for | keyframes | frames | nearest keyframe, % | found, % | wrong, % | median ms |");
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: |");
    if let Some(folder) = std::env::var_os("ITM_TEST_DATA") {
        let folder = std::path::Path::new(&folder).join("7scenes_redkitchen_head");
        let mut recording: Box<dyn Recording> = open(&folder, &OpenOptions::default()).unwrap();
        let calibration = recording.info().calibration;
        let mut slam = Slam::new(&device, &calibration, &settings, Poses::Given).unwrap();
        let mut frames: Vec<Frame> = (0..recording.info().frames).map(|i| recording.read(i).unwrap()).collect();
        let truth = recording.info().ground_truth.clone();
        for frame in &mut frames {
            let given = truth.as_ref().and_then(|t| t.poses().iter().find(|p| p.timestamp == frame.timestamp));
            frame.world_from_camera = frame.world_from_camera.or(given.map(|p| p.world_from_camera));
        }
        frames.iter().step_by(2).for_each(|frame| drop(slam.process(frame).unwrap()));
        row("kitchen, even frames; odd ones", &mut slam, frames.into_iter().skip(1).step_by(6));
    }
    settings.map.voxel_size_m = 0.01;
    settings.map.truncation_m = 0.04;
    let mut mapped = synthetic(Path::Loop, 1, 450);
    let mut slam = Slam::new(&device, &mapped.info().calibration.clone(), &settings, Poses::Given).unwrap();
    (0..450).for_each(|i| drop(slam.process(&mapped.read(i).unwrap()).unwrap()));
    for (name, path) in [("arc", Path::Arc), ("fast", Path::Fast), ("shake", Path::Shake)] {
        let mut asked = synthetic(path, 7, 40);
        row(&format!("loop; {name}"), &mut slam, (0..40).map(|i| asked.read(i).unwrap()));
    }
}
