//! How often a camera is found in a map by its keyframes: a table of recordings that were mapped and of frames that were not.
//!
//! `cargo run --release --package itm-tests --example relocalise [FOLDER…] [KEY=VALUE…]`. Each recording with ground truth is mapped
//! from its even frames at their true poses, and asked for its odd ones; without a folder those that `ITM_TEST_DATA` holds. Then come
//! synthetic rooms, asked for frames of other paths and for poses at random beside the mapped ones. `--only WORD` leaves out the
//! rows whose name has no such word, `--asked N` asks for another number of frames in each than 60, `--frames` prints a line for
//! each frame.
//!
//! A frame counts as found where its pose is within 5 cm and 5 degrees of the truth, and as wrong where another pose was taken for
//! right. Beside it: how often the pose of the most similar keyframe, and the mean pose of similar ones, are as near as
//! that; milliseconds of all processors together a frame (Linux), which other work beside it changes little, and as a clock has them.

#![allow(clippy::print_stdout, clippy::print_stderr, clippy::unwrap_used, reason = "a program of the developers'")]

use std::path::PathBuf;
use std::time::Instant;

use itm_io::recording::{OpenOptions, open};
use itm_slam::{Device, Frame, Poses, Se3, Settings, Slam};
use itm_synth::{DepthNoise, Path, Sequence, Spec, render_depth};

struct Options {
    /// Frames that are asked for in a row of the table, at most.
    asked: usize,
    only: Option<String>,
    frames: bool,
}

impl Options {
    fn wants(&self, name: &str) -> bool {
        self.only.as_ref().is_none_or(|only| name.contains(only))
    }
}

fn near(a: &Se3, b: &Se3) -> bool {
    let off = a.inverse() * *b;
    off.translation.length() <= 0.05 && off.angle().to_degrees() <= 5.0
}

fn off(a: &Se3, b: &Se3) -> String {
    let off = a.inverse() * *b;
    format!("{:.3} m {:.1} deg", off.translation.length(), off.angle().to_degrees())
}

/// Milliseconds that this process has taken of all processors, where the system says so (Linux, at a hundredth of a second).
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    after_name.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() * 10.0
}

fn row(name: &str, options: &Options, slam: &mut Slam, queries: impl Iterator<Item = Frame>) {
    if !options.wants(name) {
        return;
    }
    let (mut nearest, mut average, mut found, mut wrong) = (0, 0, 0, 0);
    let mut times = Vec::new();
    let mut cpu = 0.0;
    for frame in queries {
        let Some(truth) = frame.world_from_camera else { continue };
        let (started, cpu_before) = (Instant::now(), cpu_ms());
        let sighting = slam.find(&frame).unwrap();
        cpu += cpu_ms() - cpu_before;
        times.push(started.elapsed().as_secs_f64() * 1e3);
        let right = |pose: Option<Se3>| pose.is_some_and(|pose| near(&pose, &truth));
        let of_nearest = sighting.resembles.map(|keyframe| keyframe.submap_from_camera);
        nearest += usize::from(right(of_nearest));
        average += usize::from(right(sighting.average.map(|mean| mean.submap_from_camera)));
        let pose = sighting.found.as_ref().map(|(_, tracked)| tracked.world_from_camera);
        found += usize::from(right(pose));
        wrong += usize::from(pose.is_some() && !right(pose));
        if options.frames {
            let least = slam.keyframes().iter().map(|keyframe| keyframe.submap_from_camera.inverse() * truth);
            let least = least.map(|off| off.translation.length() + off.angle()).fold(f64::INFINITY, f64::min);
            let say = |pose: Option<Se3>| pose.map_or("none".into(), |pose| off(&pose, &truth));
            eprintln!(
                "{name} frame {}: nearest {}, found {}, wrong with {:.4}, agree {:.2}, {:.0} ms; a keyframe within {least:.2} (m + rad)",
                frame.index,
                say(of_nearest),
                say(pose),
                sighting.found.as_ref().map_or(1.0, |(_, tracked)| tracked.chance_wrong),
                sighting.found.as_ref().map_or(0.0, |(_, tracked)| tracked.inlier_share),
                times.last().unwrap(),
            );
        }
    }
    let asked = times.len();
    if asked == 0 {
        println!("| {name}: no frame with a true pose was asked for |");
        return;
    }
    times.sort_by(f64::total_cmp);
    let percent = |n: usize| 100.0 * n as f64 / asked as f64;
    println!(
        "| {name} | {} | {asked} | {:.0} | {:.0} | {:.0} | {:.0} | {:.0} | {:.0} | {:.0} |",
        slam.keyframes().len(),
        percent(nearest),
        percent(average),
        percent(found),
        percent(wrong),
        cpu / asked as f64,
        times[asked / 2],
        times[asked * 95 / 100],
    );
}

/// Maps the even frames, and asks for some of the odd ones.
fn held_apart(device: &Device, settings: &Settings, options: &Options, folder: &std::path::Path) {
    let name = format!("{}, even; odd", folder.file_name().unwrap().to_string_lossy());
    if !options.wants(&name) {
        return;
    }
    let mut recording = open(folder, &OpenOptions::default()).unwrap();
    let (calibration, count) = (recording.info().calibration, recording.info().frames);
    let mut slam = Slam::new(device, &calibration, settings, Poses::Given).unwrap();
    (0..count).step_by(2).for_each(|i| drop(slam.process(&recording.read(i).unwrap()).unwrap()));
    let odd: Vec<usize> = (1..count).step_by(2).collect();
    let step = odd.len().div_ceil(options.asked);
    row(&name, options, &mut slam, odd.into_iter().step_by(step).map(|i| recording.read(i).unwrap()));
}

/// A map of what a camera sees that goes along a path slowly.
fn mapped(device: &Device, settings: &Settings, path: Path, rate_hz: f64) -> (Slam, Sequence) {
    let spec = Spec::new(path).with_size(320, 240).with_noise(DepthNoise::KINECT, 1);
    let frames = (spec.duration_s * rate_hz) as u32;
    let sequence = Sequence::new(Spec { frame_rate_hz: rate_hz, frames, colour: false, ..spec }).unwrap();
    let mut slam = Slam::new(device, &sequence.calibration(), settings, Poses::Given).unwrap();
    sequence.frames().for_each(|frame| drop(slam.process(&frame).unwrap()));
    (slam, sequence)
}

/// Frames evenly from all of a path.
fn along(path: Path, asked: usize) -> impl Iterator<Item = Frame> {
    let spec = Spec::new(path).with_size(320, 240).with_noise(DepthNoise::KINECT, 7);
    let sequence = Sequence::new(Spec { colour: false, ..spec }).unwrap();
    let count = sequence.spec().frames;
    (0..asked as u32).map(move |i| sequence.frame(i * count / asked as u32))
}

/// Frames without noise at random beside a path: up to so far from one of its poses, and turned by up to so much.
fn beside(sequence: &Sequence, within_m: f64, within_deg: f64) -> impl Iterator<Item = Frame> + '_ {
    // Numbers from 0 to 1, always the same: Knuth's linear congruential generator of MMIX.
    let mut state = 7_u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let poses = std::iter::repeat_with(move || {
        let index = (random() * f64::from(sequence.spec().frames)) as u32;
        let mut twist = [0.0; 6];
        for (i, t) in twist.iter_mut().enumerate() {
            let within = if i < 3 { within_m } else { within_deg.to_radians() };
            // Up and down, and tilted, by less than to the sides.
            let within = if matches!(i, 1 | 3 | 5) { 0.4 * within } else { within };
            *t = within * (2.0 * random() - 1.0);
        }
        sequence.world_from_camera(index) * Se3::exp(twist)
    });
    // Not within things.
    let free = move |pose: &Se3| sequence.scene().distance(pose.translation.as_vec3()) > 0.3;
    let mut template = sequence.frame(0);
    poses.filter(free).enumerate().map(move |(index, pose)| {
        let (depth, _) = render_depth(sequence.scene(), &sequence.spec().camera, &pose);
        template.index = index as u64;
        Frame { depth: itm_slam::DepthImage::Metres(depth), world_from_camera: Some(pose), ..template.clone() }
    })
}

fn main() {
    let (mut folders, mut changes, mut options) =
        (Vec::new(), Vec::new(), Options { asked: 60, only: None, frames: false });
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--only" => options.only = arguments.next(),
            "--asked" => options.asked = arguments.next().and_then(|n| n.parse().ok()).filter(|n| *n > 0).unwrap(),
            "--frames" => options.frames = true,
            _ if argument.contains('=') => changes.push(argument),
            _ => folders.push(PathBuf::from(argument)),
        }
    }
    if let Some(folder) = std::env::var_os("ITM_TEST_DATA").map(PathBuf::from).filter(|_| folders.is_empty()) {
        folders =
            ["7scenes_redkitchen_head", "icl_lr_kt2_head", "tum_fr1_rpy_head"].map(|name| folder.join(name)).into();
    }
    let device = Device::open("auto").unwrap();
    let mut settings = Settings::resolve(None, &changes).unwrap();
    println!(
        "| mapped; asked for | keyframes | frames | nearest keyframe, % | mean pose, % | found, % | wrong, % | CPU ms | median ms | 95 % within ms |"
    );
    println!("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for folder in folders {
        held_apart(&device, &settings, &options, &folder);
    }
    settings.map.voxel_size_m = 0.01;
    settings.map.truncation_m = 0.04;
    for (path, rate_hz, others) in [
        (Path::Loop, 15.0, &[Path::Fast, Path::Arc, Path::Shake][..]),
        (Path::Eight, 10.0, &[]),
        (Path::Hall, 15.0, &[]),
    ] {
        let within = [(0.3, 15.0), (0.7, 30.0)];
        let beside_name = |(m, deg): (f64, f64)| format!("{path}; within {m} m, {deg}°");
        let names = others.iter().map(|other| format!("{path}; {other}")).chain(within.map(beside_name));
        if names.into_iter().all(|name| !options.wants(&name)) {
            continue;
        }
        let (mut slam, sequence) = mapped(&device, &settings, path, rate_hz);
        for other in others {
            row(&format!("{path}; {other}"), &options, &mut slam, along(*other, options.asked));
        }
        for (m, deg) in within {
            row(&beside_name((m, deg)), &options, &mut slam, beside(&sequence, m, deg).take(options.asked));
        }
    }
}
