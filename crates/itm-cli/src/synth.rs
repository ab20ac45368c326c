//! `itm synth`.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use itm_io::mesh::WriteOptions;
use itm_synth::{Cover, DepthNoise, Exposure, InertialNoise, Path, Quality, SceneName, Sequence, Spec};
use serde_json::json;

use crate::{console, mesh_error};

/// Edge of a cell of the exact mesh, in metres.
const SURFACE_CELL_M: f32 = 0.02;

/// Write a synthetic recording of furnished rooms, with exact poses and surface
///
/// The folder is in the format of the TUM RGB-D benchmark, with an inertial sensor's readings, calibration.txt,
/// surface.ply (the true surface, without what is carried away) and synthetic_scene.txt, by which `itm run` knows the scene that it measures the
/// reconstruction against.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm synth room                                     60 frames along an arc, with a Kinect's noise
  itm synth loop --path loop --quality fine          450 frames once around
  itm synth small --size 320x240 --frames 30 --noise off
  itm synth wall --path wall --scene blank-wall      past a wall that neither depth nor colour can be tracked by
  itm synth long --path corridor --size 320x240      30 m along a corridor and back to where it started
  itm synth again --path loop --there-and-back       once around, then the same way back
  itm synth hard --path fast --cover gradually --exposure auto --colour-delay 0.015 --motion-blur 0.02")]
pub(crate) struct Arguments {
    /// Folder to write; made where it is missing, files of the same names are replaced
    out: PathBuf,
    /// How the camera moves: arc, loop, shake (too fast), covered (a hand over the lens for a while), fast (a hand in
    /// a hurry), wall (past a bare wall), hall (a long way, much of it far from everything), corridor (30 m to its end and
    /// back), eight (through two rooms, across its own way), rooms (ten that are taken for each other), kidnapped (a hand
    /// over the lens while the camera is carried to a place seen before) or carried (standing, while a box is carried away)
    #[arg(long, default_value = "arc", value_parser = Path::from_str)]
    path: Path,
    /// Where: room, hall, wall, blank-wall, corridor, two-rooms or rooms, each of its own paths [default: the path's scene;
    /// for wall the textured one]
    #[arg(long, value_name = "NAME", value_parser = SceneName::from_str)]
    scene: Option<SceneName>,
    /// Number of frames, 30 a second [default: as many as the path's duration takes]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Then back the same way, from the last frame to the first: one frame less than twice as many
    #[arg(long)]
    there_and_back: bool,
    /// Seconds that the path takes, which sets the camera's speed [default: 2 (arc), 15
    /// (loop), 12 (fast), 10 (wall), 20 (hall), 96 (corridor), 40 (eight), 90 (rooms), 18 (kidnapped), 8 (carried),
    /// 4 (others)]
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Width and height of the images in pixels
    #[arg(long, default_value = "640x480", value_parser = parse_size)]
    size: (u32, u32),
    /// Errors of the sensors
    #[arg(long, value_enum, default_value_t = Noise::Kinect)]
    noise: Noise,
    /// A hand over the lens in the middle of the path's time: no depth, and dark colour, where it is [default: none but
    /// that of --path covered and kidnapped]
    #[arg(long, value_enum, value_name = "HOW")]
    cover: Option<CoverArgument>,
    /// Brightness of colour
    #[arg(long, value_enum, default_value_t = ExposureArgument::Fixed)]
    exposure: ExposureArgument,
    /// Colour is taken so many seconds later than depth
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_negative_numbers = true)]
    colour_delay: f64,
    /// Seconds that the colour camera's shutter is open, which blurs what moves; 0 is sharp, more takes four times as long
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    motion_blur: f64,
    /// Chooses the noise and the side that a hand comes from: the same seed gives the same recording, byte for byte
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Work that goes into colours
    #[arg(long, value_enum, default_value_t = QualityArgument::Draft)]
    quality: QualityArgument,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Show no progress
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Noise {
    /// A Kinect's depth and a phone's inertial sensor
    Kinect,
    /// Exact depth and inertial readings
    Off,
}

#[derive(Clone, Copy, ValueEnum)]
enum QualityArgument {
    /// One ray a pixel, no shadows
    Draft,
    /// Four rays a pixel, shadows and darker corners; several times slower
    Fine,
}

#[derive(Clone, Copy, ValueEnum)]
enum CoverArgument {
    /// All of the image, from 40 to 70 % of the time
    Wholly,
    /// Three fifths of the image, from 40 to 70 % of the time
    Partly,
    /// More and more of it until it is dark, then less and less, from 30 to 80 % of the time
    Gradually,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ExposureArgument {
    /// Goes up and down with time, and a little from frame to frame
    Auto,
    /// The same throughout
    Fixed,
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let sequence = Sequence::new(arguments.spec())?;
    let frames = sequence.spec().frames;
    let bar = console::bar(frames.into(), "frames", arguments.quiet);
    let written = itm_synth::write_recording(&arguments.out, &sequence, &|done| bar.set_position(done.into()))?;
    bar.finish_and_clear();

    let surface = written.folder.join("surface.ply");
    let mesh = itm_synth::exact_mesh(sequence.scene(), SURFACE_CELL_M)?;
    itm_io::mesh::write(&surface, &mesh, &WriteOptions::default())?;
    mesh_error::mark_scene(&written.folder, sequence.spec().scene).context("cannot name the scene")?;

    if arguments.json {
        console::print_json(&json!({
            "folder": written.folder,
            "scene": sequence.spec().scene.name(),
            "frames": frames,
            "ground_truth": written.ground_truth,
            "calibration": written.calibration,
            "surface": surface,
        }))?;
    } else if !arguments.quiet {
        let folder = written.folder.display();
        console::print(format_args!("{folder}: {frames} frames with exact poses (groundtruth.txt) and surface.ply"))?;
    }
    Ok(0)
}

impl Arguments {
    fn spec(&self) -> Spec {
        let mut spec = Spec::new(self.path).with_size(self.size.0, self.size.1);
        if let Some(duration_s) = self.duration {
            spec.duration_s = duration_s;
            spec.frames = (duration_s * spec.frame_rate_hz).round() as u32;
        }
        spec.frames = self.frames.unwrap_or(spec.frames).max(1);
        if self.there_and_back {
            spec = spec.there_and_back();
        }
        spec.seed = self.seed;
        spec.scene = self.scene.unwrap_or(spec.scene);
        spec.cover = self.cover.map(|cover| match cover {
            CoverArgument::Wholly => Cover::WHOLLY,
            CoverArgument::Partly => Cover::PARTLY,
            CoverArgument::Gradually => Cover::GRADUALLY,
        });
        spec.exposure = (self.exposure == ExposureArgument::Auto).then_some(Exposure::AUTO);
        spec.colour_delay_s = self.colour_delay;
        spec.motion_blur_s = self.motion_blur;
        spec.quality = match self.quality {
            QualityArgument::Draft => Quality::Draft,
            QualityArgument::Fine => Quality::Fine,
        };
        if self.noise == Noise::Kinect {
            spec.noise = Some(DepthNoise::KINECT);
            spec.inertial_noise = Some(InertialNoise::PHONE);
        }
        spec
    }
}

pub(crate) fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let size = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    size.filter(|&(w, h)| w > 0 && h > 0).ok_or_else(|| "expected WIDTHxHEIGHT, such as 640x480".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_width_times_height() {
        assert_eq!(parse_size("641x479"), Ok((641, 479)));
        for bad in ["640", "640x", "0x480", "640x-1", "axb"] {
            assert!(parse_size(bad).is_err(), "{bad}");
        }
    }
}
