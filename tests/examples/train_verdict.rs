//! Trains the classifier of tracking's verdicts on synthetic recordings, and measures it on others.
//!
//! `cargo xtask train-verdict` runs this. Training: frames are fused at their exact poses (jittered by what a good track
//! drifts), and each is then tracked from many starts, from where the camera was just before up to far away. A sample is
//! wrong where the pose found is more than 5 cm or 5 degrees from the truth, right within half of that. What judges frames
//! after a loss, without the jump from the expected pose, learns from more: maps of surfels, more covered lenses, and later
//! frames, much of which the map does not show yet. Measuring: whole recordings of other paths, seeds and conditions are
//! tracked as a user would, and each frame's error is counted against the last frame with a good verdict.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program of the developers'")]

use std::path::Path as FilePath;

use itm_io::recording::{OpenOptions, Recording, open};
use itm_slam::tracking::{Classifier, FEATURES, Features, Regression, terms};
use itm_slam::{Device, Frame, FrameStatus, Mode, Poses, Se3, Settings, Slam};
use itm_synth::{Cover, DepthNoise, Path, SceneName, Sequence, Spec};
use itm_tests::InMemory;
use nalgebra::{DMatrix, DVector};

const WRONG_M: f64 = 0.05;
const WRONG_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;

/// Random numbers in a fixed order (SplitMix64; Steele et al. 2014).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A motion with a translation up to, and a rotation up to; directions and shares at random.
    fn motion(&mut self, metres: f64, radians: f64) -> Se3 {
        let mut direction = || {
            let v = [0, 1, 2].map(|_| 2.0 * self.uniform() - 1.0);
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
            v.map(|x| x / length)
        };
        let (t, r) = (direction(), direction());
        let (a, b) = (metres * self.uniform(), radians * self.uniform());
        Se3::exp([a * t[0], a * t[1], a * t[2], b * r[0], b * r[1], b * r[2]])
    }
}

/// Size, noise and conditions of a recording.
fn spec(path: Path, seed: u64, size: (u32, u32)) -> Spec {
    Spec::new(path).with_size(size.0, size.1).with_noise(DepthNoise::KINECT, seed)
}

fn settings(voxel_size_m: f32) -> Settings {
    let mut settings = Settings::default();
    settings.map.voxel_size_m = voxel_size_m;
    settings.map.truncation_m = 4.0 * voxel_size_m;
    settings.map.colour = false;
    settings.view.colour = false;
    settings
}

#[derive(Clone, Copy)]
struct Sample {
    features: Features,
    wrong: bool,
    /// It says nothing of where the camera is expected.
    only_in_doubt: bool,
}

/// How many of the frames that are looked at a later one comes after the last that the map knows.
const AHEAD: u32 = 8;

fn error(a: &Se3, b: &Se3) -> (f64, f64) {
    let e = a.inverse() * *b;
    (e.translation.length(), e.angle())
}

/// Frames of a recording, tracked from many starts against a map made at exact poses.
fn samples(
    device: &Device,
    (spec, every, only_in_doubt): (Spec, u32, bool),
    settings: &Settings,
    random: &mut Random,
    out: &mut Vec<Sample>,
) {
    let spec = Spec { colour: false, ..spec };
    let sequence = Sequence::new(spec).unwrap();
    let mut slam = Slam::new(device, &sequence.calibration(), settings, Poses::Tracked).unwrap();
    let mut poses: Vec<Se3> = Vec::new();
    let before = out.len();
    let mut probe = |slam: &mut Slam, frame: &Frame, starts: &[Se3], only_in_doubt: bool| {
        let truth = frame.world_from_camera.unwrap();
        for start in starts {
            let Some(found) = slam.probe(frame, &[*start]).unwrap() else { continue };
            let Some(features) = found.features else { continue };
            let (metres, radians) = error(&truth, &found.estimate);
            let wrong = metres > WRONG_M || radians > WRONG_RAD;
            if wrong || (metres < 0.5 * WRONG_M && radians < 0.5 * WRONG_RAD) {
                out.push(Sample { features, wrong, only_in_doubt });
            }
        }
    };
    for i in (0..spec.frames).step_by(every as usize) {
        let frame = sequence.frame(i);
        let truth = frame.world_from_camera.unwrap();
        if let Some(&last) = poses.last() {
            let mut starts = vec![last];
            starts.extend([3, 8].iter().filter_map(|k| poses.len().checked_sub(*k)).map(|at| poses[at]));
            for (metres, radians) in [(0.03, 0.03), (0.1, 0.1), (0.25, 0.25), (0.6, 0.6), (0.4, 0.0), (0.0, 0.5)] {
                starts.push(truth * random.motion(metres, radians));
            }
            probe(&mut slam, &frame, &starts, only_in_doubt);
            let later = i + AHEAD * every;
            if poses.len().is_multiple_of(2) && later < spec.frames {
                let frame = sequence.frame(later);
                let truth = frame.world_from_camera.unwrap();
                let mut random = Random(later.into());
                let mut starts = vec![last];
                for (metres, radians) in [(0.03, 0.03), (0.1, 0.1), (0.3, 0.1), (0.3, 0.3)] {
                    starts.push(truth * random.motion(metres, radians));
                }
                probe(&mut slam, &frame, &starts, true);
            }
        }
        // What a good track is off by, so that the map is not better than maps are.
        let pose = truth * random.motion(0.004, 0.002);
        slam.place(&frame, &pose).unwrap();
        poses.push(truth);
    }
    let wrong = out[before..].iter().filter(|s| s.wrong).count();
    println!(
        "{} ({}x{}, {:?}): {} samples, {wrong} wrong",
        spec.path,
        spec.camera.width,
        spec.camera.height,
        settings.mode,
        out.len() - before
    );
}

/// Logistic regression by Newton's method, with a penalty on the weights.
fn fit(samples: &[Sample], classifier: &Classifier) -> Regression {
    let rows: Vec<Vec<f64>> = samples.iter().map(|s| terms(&classifier.standardise(&s.features))).collect();
    let (n, d) = (rows.len(), rows[0].len());
    let wrong = samples.iter().filter(|s| s.wrong).count() as f64;
    // Both classes count alike.
    let weight = |s: &Sample| 0.5 * n as f64 / if s.wrong { wrong } else { n as f64 - wrong };
    let mut w = DVector::zeros(d);
    for _ in 0..30 {
        let mut hessian = DMatrix::identity(d, d) * 3.0;
        hessian[(0, 0)] = 1e-6;
        let mut gradient = DVector::from_fn(d, |i, _| if i == 0 { 0.0 } else { 3.0 * w[i] });
        for (row, sample) in rows.iter().zip(samples) {
            let x = DVector::from_column_slice(row);
            let p = 1.0 / (1.0 + (-x.dot(&w)).exp());
            let c = weight(sample);
            gradient += c * (p - f64::from(u8::from(sample.wrong))) * &x;
            hessian.ger(c * p * (1.0 - p) + 1e-9, &x, &x, 1.0);
        }
        let step = hessian.cholesky().unwrap().solve(&gradient);
        w -= &step;
        if step.norm() < 1e-6 {
            break;
        }
    }
    let weights = w.iter().map(|v| (v * 1e4).round() / 1e4).collect();
    Regression { weights, ..Regression::default() }
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// Where a regression's classes part: such a share of the wrong poses of training may be good, and so few of the right ones lost; real
/// conditions are harder.
fn limits(samples: &[Sample], classifier: &Classifier, wrong_but_good: f64) -> [f64; 2] {
    let chances = |wrong: bool| -> Vec<f64> {
        samples.iter().filter(|s| s.wrong == wrong).map(|s| classifier.chance_wrong(&s.features)).collect()
    };
    let good_below = quantile(&mut chances(true), wrong_but_good).min(0.5);
    let lost_above = quantile(&mut chances(false), 0.998).max(good_below).max(0.9);
    let share =
        |v: Vec<f64>, f: &dyn Fn(f64) -> bool| 100.0 * v.iter().filter(|c| f(**c)).count() as f64 / v.len() as f64;
    println!(
        "trained on {} samples, {} wrong: good up to {good_below:.3}, lost above {lost_above:.3}; of the wrong {:.2} % are called \
         good, of the right {:.2} % poor or lost, {:.2} % lost",
        samples.len(),
        chances(true).len(),
        share(chances(true), &|c| c <= good_below),
        share(chances(false), &|c| c > good_below),
        share(chances(false), &|c| c > lost_above),
    );
    [good_below, lost_above]
}

/// Trains both regressions, or the second alone beside the first as it stands in the file.
fn train(device: &Device, to: &FilePath, in_doubt_alone: bool) {
    let mut all = Vec::new();
    for mode in [Mode::Basic, Mode::Surfels] {
        let mut random = Random(7);
        let small = (160, 120);
        let large = (320, 240);
        // Where the camera is expected is for maps of voxels, and without more covered lenses: with them a frame was good at the last
        // glimpse of a covered lens, 6 to 9 cm off.
        let only_in_doubt = mode != Mode::Basic;
        let mut add = |spec: Spec, every: u32, voxel_size_m: f32, only_in_doubt: bool| {
            let settings = Settings { mode, ..settings(voxel_size_m) };
            samples(device, (spec, every, only_in_doubt), &settings, &mut random, &mut all);
        };
        add(spec(Path::Arc, 11, large), 2, 0.01, only_in_doubt);
        add(spec(Path::Loop, 12, large), 9, 0.01, only_in_doubt);
        add(spec(Path::Loop, 13, small), 5, 0.01, only_in_doubt);
        add(spec(Path::Shake, 14, large), 3, 0.01, only_in_doubt);
        add(spec(Path::Fast, 15, small), 4, 0.01, only_in_doubt);
        add(spec(Path::Wall, 16, small), 4, 0.01, only_in_doubt);
        add(Spec { scene: SceneName::BlankWall, ..spec(Path::Wall, 17, small) }, 5, 0.01, only_in_doubt);
        add(spec(Path::Hall, 18, small), 6, 0.01, only_in_doubt);
        for cover in [Cover::PARTLY, Cover::GRADUALLY] {
            add(Spec { cover: Some(cover), ..spec(Path::Arc, 19, small) }, 1, 0.01, only_in_doubt);
        }
        add(Spec { noise: None, ..spec(Path::Loop, 20, small) }, 9, 0.01, only_in_doubt);
        add(spec(Path::Arc, 21, large), 4, 0.005, only_in_doubt);
        // Much of what is known of views with hardly any depth.
        for (path, seed, every) in [(Path::Arc, 22, 1), (Path::Loop, 23, 3), (Path::Fast, 24, 3)] {
            let size = if path == Path::Arc { large } else { small };
            add(Spec { cover: Some(Cover::GRADUALLY), ..spec(path, seed, size) }, every, 0.01, true);
        }
    }
    let expected: Vec<Sample> = all.iter().filter(|s| !s.only_in_doubt).copied().collect();
    let without_jump = |s: &Sample| Sample { features: Features { jump: None, ..s.features }, ..*s };
    let in_doubt: Vec<Sample> = all.iter().map(without_jump).collect();
    let of = |i: usize, good: bool| -> Vec<f64> {
        let counted = expected.iter().filter(|s| !good || !s.wrong);
        counted.map(|s| s.features.values().nth(i).unwrap()).collect()
    };
    let mean: [f64; FEATURES] = std::array::from_fn(|i| of(i, false).iter().sum::<f64>() / expected.len() as f64);
    let scale = std::array::from_fn(|i| {
        let v = of(i, false);
        (v.iter().map(|x| (x - mean[i]).powi(2)).sum::<f64>() / v.len() as f64).sqrt().max(1e-3)
    });
    let usual = std::array::from_fn(|i| [0.01, 0.99].map(|share| quantile(&mut of(i, true), share)));
    let mut classifier = if in_doubt_alone {
        toml::from_str(&std::fs::read_to_string(to).unwrap()).unwrap()
    } else {
        Classifier { mean, scale, usual, expected: Regression::default(), in_doubt: Regression::default() }
    };
    if !in_doubt_alone {
        classifier.expected = fit(&expected, &classifier);
        let [good_below, lost_above] = limits(&expected, &classifier, 0.004);
        classifier.expected = Regression { good_below, lost_above, ..classifier.expected };
    }
    classifier.in_doubt = fit(&in_doubt, &classifier);
    // Several must be good in a row; and maps of real rooms contradict right poses more often than those of synthetic ones do.
    let [good_below, lost_above] = limits(&in_doubt, &classifier, 0.02);
    classifier.in_doubt = Regression { good_below, lost_above, ..classifier.in_doubt };
    let head = "# The classifier of tracking's verdicts (crates/itm-slam/src/tracking/classifier.rs). Made by\n#   cargo xtask train-verdict\n";
    std::fs::write(to, head.to_string() + &toml::to_string(&classifier).unwrap()).unwrap();
}

/// Counts over frames whose truth is known.
#[derive(Default)]
struct Counts {
    frames: usize,
    off: usize,
    off_but_good: usize,
    right: usize,
    right_but_poor: usize,
    right_but_lost: usize,
}

impl Counts {
    fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.off += other.off;
        self.off_but_good += other.off_but_good;
        self.right += other.right;
        self.right_but_poor += other.right_but_poor;
        self.right_but_lost += other.right_but_lost;
    }

    fn print(&self, name: &str) {
        let share =
            |a: usize, b: usize| if b == 0 { String::from("-") } else { format!("{:.1}", 100.0 * a as f64 / b as f64) };
        let called_bad = self.off - self.off_but_good;
        let flagged = called_bad + self.right_but_poor + self.right_but_lost;
        println!(
            "| {name} | {} | {} | {} | {} | {} | {} |",
            self.frames,
            self.off,
            share(called_bad, self.off),
            share(called_bad, flagged),
            share(self.right_but_poor, self.right),
            share(self.right_but_lost, self.right),
        );
    }
}

/// Runs a recording as a user would. A frame's error is that of its motion since the last frame with a good verdict: the
/// frame's own estimate, whatever was made of it.
fn measure(
    device: &Device,
    recording: &mut dyn Recording,
    settings: &Settings,
    wrong_start: Option<(usize, Se3)>,
) -> Counts {
    let info = recording.info().clone();
    let mut settings = settings.clone();
    settings.map.colour &= info.has_colour;
    let mut slam = Slam::new(device, &info.calibration, &settings, Poses::Tracked).unwrap();
    let mut counts = Counts::default();
    let mut last_good: Option<(Se3, Se3)> = None;
    for i in 0..info.frames {
        let frame: Frame = recording.read(i).unwrap();
        let truth = frame.world_from_camera;
        if let (Some((every, offset)), Some((estimate, _))) = (&wrong_start, &last_good)
            && i % every == 0
        {
            // As if tracking began elsewhere: only the verdict counts.
            let found = slam.probe(&frame, &[*estimate * *offset]).unwrap().unwrap();
            if let (Some(truth), Some((good, true_good))) = (truth, &last_good) {
                let (metres, radians) = error(&(true_good.inverse() * truth), &(good.inverse() * found.estimate));
                count(&mut counts, metres, radians, found.verdict.name());
            }
        }
        let result = slam.process(&frame).unwrap();
        let name = match &result.status {
            FrameStatus::Placed | FrameStatus::Tracked => "good",
            FrameStatus::Poor { .. } => "poor",
            _ => "lost",
        };
        let Some(truth) = truth else { continue };
        let estimate = result.tracked.as_ref().map(|t| t.estimate).or(result.world_from_camera);
        if let (Some((good, true_good)), Some(estimate)) = (&last_good, estimate) {
            let (metres, radians) = error(&(true_good.inverse() * truth), &(good.inverse() * estimate));
            count(&mut counts, metres, radians, name);
        }
        if name == "good" {
            last_good = result.world_from_camera.map(|pose| (pose, truth));
        }
    }
    counts
}

fn count(counts: &mut Counts, metres: f64, radians: f64, verdict: &str) {
    counts.frames += 1;
    if metres > WRONG_M || radians > WRONG_RAD {
        counts.off += 1;
        counts.off_but_good += usize::from(verdict == "good");
    } else {
        counts.right += 1;
        counts.right_but_poor += usize::from(verdict == "poor");
        counts.right_but_lost += usize::from(verdict == "lost");
    }
}

/// Measures with some settings that are not the default, as `mode=surfels`.
fn evaluate(device: &Device, overrides: &[String]) {
    let with_overrides = |settings: &Settings| {
        let text = toml::to_string(settings).unwrap();
        Settings::resolve(Some(("the settings of the measurement", &text)), overrides).unwrap()
    };
    println!(
        "| recording | frames | off | of these poor or lost, % | of poor or lost these, % | right but poor, % | right but lost, % |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let mut total = Counts::default();
    let mut run = |name: &str, spec: Spec, frames: u32, wrong_start: Option<(usize, Se3)>| {
        let spec = Spec { frames: spec.frames.min(frames), ..spec };
        let mut recording = InMemory::new(Sequence::new(spec).unwrap());
        let counts = measure(
            device,
            &mut recording,
            &with_overrides(&Settings { view: Settings::default().view, ..settings(0.01) }),
            wrong_start,
        );
        counts.print(name);
        total.add(&counts);
    };
    let size = (320, 240);
    for (name, cover) in [("wholly", Cover::WHOLLY), ("partly", Cover::PARTLY), ("gradually", Cover::GRADUALLY)] {
        let arc = Spec { duration_s: 3.3, frames: 130, ..spec(Path::Arc, 101, size) };
        run(&format!("arc, lens covered {name}"), Spec { cover: Some(cover), ..arc }, 130, None);
    }
    let fast = |seconds: f64, seed: u64| Spec { duration_s: seconds, ..spec(Path::Fast, seed, size) };
    run("fast", fast(12.0, 102), 360, None);
    run("fast, twice as fast", fast(6.0, 103), 180, None);
    run("shake", spec(Path::Shake, 104, size), 120, None);
    run("blank wall", Spec { scene: SceneName::BlankWall, ..spec(Path::Wall, 105, size) }, 300, None);
    run("hall", spec(Path::Hall, 106, size), 300, None);
    for (name, offset) in [
        ("0.3 m aside", Se3::exp([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])),
        ("25 degrees turned", Se3::exp([0.0, 0.0, 0.0, 0.0, 0.44, 0.0])),
        ("0.2 m and 15 degrees", Se3::exp([0.1, 0.1, 0.14, 0.15, 0.15, 0.15])),
    ] {
        run(&format!("loop, wrong start pose, {name}"), spec(Path::Loop, 107, size), 150, Some((3, offset)));
    }
    total.print("all of these");
    let Some(data) = std::env::var_os("ITM_TEST_DATA") else { return };
    let folders = std::fs::read_dir(data).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_dir());
    let mut folders: Vec<_> = folders.collect();
    folders.sort();
    for folder in folders {
        let Ok(mut recording) = open(&folder, &OpenOptions::default()) else { continue };
        let name = recording.info().name.clone();
        measure(device, recording.as_mut(), &with_overrides(&Settings::default()), None).print(&name);
    }
}

fn main() {
    let device = Device::open("auto").unwrap();
    let mut arguments = std::env::args().skip(1);
    match (arguments.next().as_deref(), arguments.next()) {
        (Some("train"), Some(to)) => train(&device, to.as_ref(), arguments.next().as_deref() == Some("in-doubt")),
        (Some("measure"), first) => evaluate(&device, &first.into_iter().chain(arguments).collect::<Vec<_>>()),
        _ => println!("usage: train_verdict train FILE [in-doubt] | measure [KEY=VALUE …]"),
    }
}
