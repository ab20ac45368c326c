//! Where the error of a run with submaps comes from: bends within submaps, or links between them.
//!
//! `cargo run --release --package itm-tests --example drift -- RECORDING [KEY=VALUE ...]`, for a recording with a true pose for
//! each frame.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program of the developers'")]

use std::collections::BTreeMap;

use itm_io::recording::{OpenOptions, open};
use itm_slam::{Device, Happening, Poses, Se3, Settings, Slam, StampedPose, SubmapState, Trajectory};

/// The absolute error in millimetres.
fn ate_mm(truth: &[StampedPose], found: impl Iterator<Item = Se3>) -> f64 {
    let found: Trajectory =
        truth.iter().zip(found).map(|(truth, world_from_camera)| StampedPose { world_from_camera, ..*truth }).collect();
    let truth: Trajectory = truth.iter().copied().collect();
    itm_slam::evaluation::evaluate(&found, &truth, 0).map_or(f64::NAN, |evaluation| evaluation.ate.rmse * 1e3)
}

/// The mean of poses that are near each other.
fn mean(poses: &[Se3]) -> Se3 {
    let mut mean = poses.first().copied().unwrap_or(Se3::IDENTITY);
    for _ in 0..5 {
        let mut twist = [0.0; 6];
        for pose in poses {
            let off = (mean.inverse() * *pose).log();
            twist.iter_mut().zip(off).for_each(|(sum, off)| *sum += off / poses.len() as f64);
        }
        mean = mean * Se3::exp(twist);
    }
    mean
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().expect("a recording's folder");
    let overrides: Vec<String> = std::iter::once("mode=loop-closure".to_owned()).chain(arguments).collect();
    let settings = Settings::resolve(None, &overrides).unwrap();
    let mut recording = open(folder.as_ref(), &OpenOptions::default()).unwrap();
    let info = recording.info().clone();
    let device = Device::open("auto").unwrap();
    let mut slam = Slam::new(&device, &info.calibration, &settings, Poses::Tracked).unwrap();
    let given = info.ground_truth.clone().unwrap();
    // Of each frame: the truth, its submap, and its pose there.
    let mut frames: Vec<(StampedPose, u16, Se3)> = Vec::new();
    let mut times: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for index in 0..info.frames {
        let frame = recording.read(index).unwrap();
        let started = std::time::Instant::now();
        let result = slam.process(&frame).unwrap();
        let active = slam.submaps().iter().filter(|submap| submap.state != SubmapState::Passive).count();
        times.entry(active).or_default().push(started.elapsed().as_secs_f64() * 1e3);
        for happening in &result.happenings {
            if !matches!(happening, Happening::Keyframe { .. } | Happening::Optimised(_)) {
                println!("{index:5} {happening}");
            }
        }
        let Some(truth) = given.poses().iter().find(|pose| pose.timestamp == frame.timestamp) else { continue };
        let Some(pose) = result.world_from_camera else { continue };
        let submap = slam.submaps().get(usize::from(result.submap));
        let world_from_submap = submap.map_or(Se3::IDENTITY, |submap| submap.world_from_submap);
        frames.push((*truth, result.submap, world_from_submap.inverse() * pose));
    }
    let truth: Vec<StampedPose> = frames.iter().map(|(truth, ..)| *truth).collect();
    let live: Vec<Se3> = slam.trajectory().poses().iter().map(|pose| pose.world_from_camera).collect();
    println!("{} frames, {} submaps", frames.len(), slam.submaps().len());
    println!("ATE live             {:7.2} mm", ate_mm(&truth, live.into_iter()));
    let by = |slam: &Slam| {
        let mut poses: Vec<Se3> = slam.submaps().iter().map(|submap| submap.world_from_submap).collect();
        poses.resize(poses.len().max(1), Se3::IDENTITY);
        ate_mm(&truth, frames.iter().map(|(_, submap, pose)| poses[usize::from(*submap)] * *pose))
    };
    println!("ATE before settling  {:7.2} mm", by(&slam));
    slam.settle();
    println!("ATE, primary submaps {:7.2} mm", by(&slam));
    let means: Vec<Se3> = slam.corrected_trajectory().poses().iter().map(|pose| pose.world_from_camera).collect();
    println!("ATE                  {:7.2} mm", ate_mm(&truth, means.into_iter()));
    // Where the truth has each submap, by positions and orientations of all its frames: on a straight way positions alone would
    // leave its roll open.
    let best: Vec<(usize, f64, Se3)> = (0..slam.submaps().len().max(1))
        .map(|number| {
            let own = || frames.iter().filter(move |(_, submap, _)| usize::from(*submap) == number);
            let truth: Vec<StampedPose> = own().map(|(truth, ..)| *truth).collect();
            let of_submap: Vec<Se3> = own().map(|(truth, _, pose)| truth.world_from_camera * pose.inverse()).collect();
            (truth.len(), ate_mm(&truth, own().map(|(_, _, pose)| *pose)), mean(&of_submap))
        })
        .collect();
    let placed = frames.iter().map(|(_, submap, pose)| best[usize::from(*submap)].2 * *pose);
    println!("ATE, best submaps    {:7.2} mm", ate_mm(&truth, placed));
    println!("| submap | frames | bend, mm |");
    for (number, (frames, bend, _)) in best.iter().enumerate() {
        println!("| {number} | {frames} | {bend:.2} |");
    }
    for (active, mut times) in times {
        times.sort_by(f64::total_cmp);
        println!("{} frames with {active} active submaps: {:.1} ms", times.len(), times[times.len() / 2]);
    }
    println!("| link | closure | frames | off at the camera, mm | off, deg |");
    for link in slam.submap_links() {
        // Where the camera was in the newer one.
        let own = frames.iter().filter(|(_, submap, _)| *submap == link.from.max(link.to));
        let camera = own.map(|(.., pose)| *pose).next().unwrap_or(Se3::IDENTITY);
        let to_from_camera = if link.to > link.from { camera } else { link.from_from_to.inverse() * camera };
        let true_link = best[usize::from(link.from)].2.inverse() * best[usize::from(link.to)].2;
        let off = (true_link * to_from_camera).inverse() * (link.from_from_to * to_from_camera);
        println!(
            "| {} - {} | {} | {} | {:.2} | {:.3} |",
            link.from,
            link.to,
            link.closure,
            link.frames,
            off.translation.length() * 1e3,
            off.angle().to_degrees()
        );
    }
}
