//! `itm eval`.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use itm_core::evaluation::{self, Evaluation};
use itm_core::{StampedPose, Trajectory};
use itm_io::recording::{self, OpenOptions, Topics};
use itm_io::trajectory::read_tum;
use serde::Serialize;

use crate::console;

/// Measure a trajectory against the truth: absolute trajectory error (ATE) and relative pose error (RPE)
///
/// Both are files of rows 'timestamp tx ty tz qx qy qz qw', camera to world. Poses are paired with the nearest in time,
/// and worlds aligned by a rigid motion (no scale). Files whose first column holds frame numbers may be compared with
/// each other.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm eval out/desk/trajectory.txt rgbd_dataset_freiburg1_desk/groundtruth.txt
  itm eval out/desk/trajectory.txt rgbd_dataset_freiburg1_desk       the recording's folder will do
  itm eval trajectory.txt livingRoom2.gt.freiburg --json")]
pub(crate) struct Arguments {
    /// Estimated trajectory
    #[arg(value_name = "EST")]
    estimate: PathBuf,
    /// True trajectory, or a recording that has one: its folder, or an MCAP file
    #[arg(value_name = "GT")]
    truth: PathBuf,
    /// Topics of an MCAP file, as of itm run: pose=/vicon/camera
    #[arg(long, value_name = "NAME=TOPIC,…", value_parser = Topics::from_str)]
    topics: Option<Topics>,
    /// How far apart in time two poses of a pair may be, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 20.0, value_parser = parse_tolerance)]
    tolerance_ms: f64,
    /// Print JSON, in metres and radians
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Answer<'a> {
    /// Frames of the recording, where GT is one.
    frames: Option<usize>,
    /// Share of them with an estimated pose.
    posed_share: Option<f64>,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let mut estimate = read_tum(&arguments.estimate)?;
    let is_recording = arguments.truth.is_dir() || recording::is_file_of_recording(&arguments.truth);
    let (truth, frames) = if is_recording {
        let topics = arguments.topics.clone().unwrap_or_default();
        let recording = recording::open(&arguments.truth, &OpenOptions { topics, ..OpenOptions::default() })?;
        let info = recording.info();
        let Some(truth) = &info.ground_truth else {
            bail!("the recording '{}' has no ground truth", arguments.truth.display());
        };
        if !info.has_timestamps {
            estimate = from_image_numbers(estimate);
        }
        (truth.clone(), Some(info.frames))
    } else {
        (read_tum(&arguments.truth)?, None)
    };
    let tolerance_ns = (arguments.tolerance_ms * 1e6).round() as i64;
    let evaluation = evaluation::evaluate(&estimate, &truth, tolerance_ns).with_context(|| compared(arguments))?;
    let posed_share = frames.map(|frames| evaluation.estimate_poses as f64 / frames as f64);
    if arguments.json {
        console::print_json(&Answer { frames, posed_share, evaluation: &evaluation })?;
    } else {
        console::print(evaluation)?;
        console::print(match (frames, posed_share) {
            (Some(frames), Some(share)) => {
                format!(
                    "frames with a pose: {} of the recording's {frames} ({:.1} %)",
                    evaluation.estimate_poses,
                    share * 100.0
                )
            }
            _ => "frames with a pose: not known from these files; the recording's folder as GT would tell".into(),
        })?;
    }
    Ok(0)
}

fn compared(arguments: &Arguments) -> String {
    let shown = |path: &Path| path.display().to_string();
    format!("cannot compare '{}' with '{}'", shown(&arguments.estimate), shown(&arguments.truth))
}

/// The nominal times of an estimate whose time column holds image numbers, each read as so many seconds. One with times
/// between whole seconds is left as it is: its times are nominal already.
fn from_image_numbers(estimate: Trajectory) -> Trajectory {
    const SECOND_NS: i64 = 1_000_000_000;
    let number = |p: &StampedPose| {
        let seconds = u32::try_from(p.timestamp.0.div_euclid(SECOND_NS)).ok()?;
        (p.timestamp.0.rem_euclid(SECOND_NS) == 0).then_some(seconds)
    };
    let numbers: Option<Vec<u32>> = estimate.poses().iter().map(number).collect();
    let Some(numbers) = numbers else { return estimate };
    let at =
        |(number, pose): (u32, &StampedPose)| StampedPose { timestamp: recording::nominal_timestamp(number), ..*pose };
    numbers.into_iter().zip(estimate.poses()).map(at).collect()
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    let tolerance = text.parse().ok().filter(|ms| (0.0..=1e9).contains(ms));
    tolerance.ok_or_else(|| "expected milliseconds, such as 20".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use itm_core::{Se3, Timestamp};

    fn trajectory(times: &[i64]) -> Trajectory {
        times.iter().map(|t| StampedPose { timestamp: Timestamp(*t), world_from_camera: Se3::IDENTITY }).collect()
    }

    #[test]
    fn image_numbers_become_nominal_times_and_nominal_times_stay() {
        let numbers = trajectory(&[0, 30_000_000_000, 31_000_000_000]);
        let times: Vec<i64> = from_image_numbers(numbers).poses().iter().map(|p| p.timestamp.0).collect();
        assert_eq!(times, [0, 1_000_000_000, 1_033_333_333]);
        let nominal = trajectory(&[0, 1_000_000_000, 1_033_333_333]);
        assert_eq!(from_image_numbers(nominal.clone()), nominal);
    }

    #[test]
    fn tolerances_are_times() {
        assert_eq!(parse_tolerance("2.5"), Ok(2.5));
        assert!(["-1", "nan", "x", "1e300"].iter().all(|bad| parse_tolerance(bad).is_err()));
    }
}
