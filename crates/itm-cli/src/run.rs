//! `itm run`.

use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File, OpenOptions};
use std::io::{BufWriter, ErrorKind};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::{Context as _, Error, Result, anyhow, bail};
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use itm_core::evaluation::{self, Evaluation};
use itm_core::{Mesh, Mode, Se3, Settings, StampedPose, Trajectory};
use itm_io::map_file::MapReader;
use itm_io::mesh::{MeshOptions, UpAxis};
use itm_io::recording::{self, RecordingInfo};
use itm_io::trajectory::{TimeColumn, TumWriter};
use itm_slam::{
    Device, Event, FrameReport, FrameResult, FrameStatus, Happening, Keyframe, Notice, Poses, SavedSession, Session,
    SessionOptions, Start,
};
use serde::Serialize;
use serde_json::json;

use crate::mesh_error::{self, MeshError};
use crate::recordings::RecordingArguments;
use crate::timings::{self, Row, STAGES, Timings};
use crate::{console, pictures, report};

/// Reconstruct a recording: trajectory, coloured mesh, timings and a report
///
/// The format is recognised: folders in those of TUM RGB-D, ICL-NUIM and 7-Scenes, MCAP files, or images with a calibration
/// file. OUT then
/// holds trajectory.txt (TUM format, camera to world), mesh.ply, settings.toml, timings.csv and report.html, and
/// metrics.json where the recording has ground truth. Results of an earlier run there are replaced.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm run rgbd_dataset_freiburg1_desk
  itm run redkitchen/seq-01 -o kitchen --frames 0..300 --set map.voxel_size_m=0.01
  itm run bag.mcap --topics depth=/camera/depth/image_raw,color=/camera/color/image_raw
  itm run scan --depth-pattern 'depth/%06d.png' --calibration calib.txt
  itm run room --poses given --json
  itm run room --tracker type=extended,levels=rrbb,useDepth=1 --explain
  itm run room --tracker 'type=composite,policy=first-success;type=icp;type=extended'
  itm run room --frames 0..150 --save room.itm
  itm run room --resume room.itm --save room.itm
  itm run room --map room.itm --start-pose 0,0,0,0,0,0,1 --fusion off

The kinds of --tracker are icp, extended, rgb, imuicp, extendedimu, file, forcefail and composite; the keys of each are in
crates/itm-core/src/settings/tracker_string.rs and in the message about one that is not known; the settings that they
stand for, in crates/itm-core/src/settings/tracker.rs and in the settings.toml of any run. Later ones win: --settings, each
--set in order, then flags, --tracker among them; what its string does not name stays as those before it said.

Ctrl-C ends the run after the current frame; mesh and report are written all the same.
Exit status: 0 complete, 130 stopped by Ctrl-C, 1 error, 2 bad command line.")]
pub(crate) struct Arguments {
    /// Folder of the recording, or an MCAP file
    recording: PathBuf,
    /// Folder for the results, made where it is missing [default: out/NAME, with the recording's name]
    #[arg(short, long)]
    out: Option<PathBuf>,
    /// Only these frames, by their place in the recording from 0; B is not included (also A.. and ..B)
    #[arg(long, value_name = "A..B", value_parser = FrameRange::from_str)]
    frames: Option<FrameRange>,
    /// Settings as TOML; every run writes its own to OUT/settings.toml
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// A single setting, which wins over the file: --set map.voxel_size_m=0.01 (may be repeated)
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// The tracker as one string, type=KIND,key=value,... (see below); wins over the settings and --set
    #[arg(long, value_name = "STRING")]
    tracker: Option<String>,
    /// Go on from a session that --save left, with its settings, at the frame after its last one
    #[arg(long, value_name = "MAP", conflicts_with_all = ["settings", "overrides", "tracker", "poses", "map", "calibration"])]
    resume: Option<PathBuf>,
    /// Start in a saved map, with its settings unless --settings gives others
    #[arg(long, value_name = "MAP")]
    map: Option<PathBuf>,
    /// Where the first frame's camera is in that map: metres, then a quaternion [default: it is found by the map's keyframes]
    #[arg(long, value_name = "TX,TY,TZ,QX,QY,QZ,QW", requires = "map", value_parser = pose_from_str, allow_hyphen_values = true)]
    start_pose: Option<Se3>,
    /// Whether frames are fused into the map; off finds the camera in a saved map without changing it
    #[arg(long, value_enum)]
    fusion: Option<Switch>,
    /// Save the map, and the session, to this file at the end, also after Ctrl-C
    #[arg(long, value_name = "MAP")]
    save: Option<PathBuf>,
    /// What kind of map is made; wins over the settings and --set
    #[arg(long, value_enum)]
    mode: Option<ModeArgument>,
    /// Where camera poses come from
    #[arg(long, value_enum, default_value_t = PosesArgument::Tracked)]
    poses: PosesArgument,
    /// Adapter: auto, a number from 'itm devices' or a part of its name; wins over the settings
    #[arg(long)]
    device: Option<String>,
    #[command(flatten)]
    open: RecordingArguments,
    /// Formats of the mesh, one file each: mesh.ply, mesh.glb …
    #[arg(long, value_enum, value_delimiter = ',', default_value = "ply", value_name = "FORMATS")]
    mesh_format: Vec<MeshFormat>,
    /// Which way is up in mesh files; by default they keep the trajectory's world. GLB is always y-up
    #[arg(long, value_enum)]
    up: Option<UpArgument>,
    /// Write no mesh
    #[arg(long, conflicts_with_all = ["mesh_format", "up"])]
    no_mesh: bool,
    /// Say of each frame that was not good what became of it and why; with --json also in the summary, as not_good
    #[arg(long)]
    explain: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    /// Show no progress, and print no summary but with --json
    #[arg(short, long)]
    quiet: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PosesArgument {
    /// From tracking
    Tracked,
    /// The recording's own
    Given,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ModeArgument {
    /// One map, in which an error of tracking stays
    Basic,
    /// Submaps that are corrected where the camera comes back to a place
    LoopClosure,
    /// One map of discs on surfaces
    Surfels,
    /// Submaps of discs on surfaces
    SurfelsLoopClosure,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Switch {
    On,
    Off,
}

/// A pose as seven numbers: translation in metres, then a quaternion x, y, z, w.
pub(crate) fn pose_from_str(text: &str) -> Result<Se3, String> {
    let expected = || format!("expected seven numbers tx,ty,tz,qx,qy,qz,qw, not '{text}'");
    let numbers: Vec<f64> =
        text.split(',').map(|n| n.trim().parse().map_err(|_| expected())).collect::<Result<_, _>>()?;
    let [tx, ty, tz, qx, qy, qz, qw] = numbers[..] else { return Err(expected()) };
    let rotation = glam::DQuat::from_xyzw(qx, qy, qz, qw);
    if numbers.iter().any(|n| !n.is_finite()) || rotation.length() < 1e-6 {
        return Err(format!("{}; a quaternion is not zero", expected()));
    }
    Ok(Se3::new(rotation.normalize(), glam::DVec3::new(tx, ty, tz)))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MeshFormat {
    /// Binary, with colours and weights
    Ply,
    /// Text, with colours
    Obj,
    /// Binary, shape only
    Stl,
    /// glTF, binary, with colours
    Glb,
}

impl MeshFormat {
    fn file_name(self) -> &'static str {
        match self {
            Self::Ply => "mesh.ply",
            Self::Obj => "mesh.obj",
            Self::Stl => "mesh.stl",
            Self::Glb => "mesh.glb",
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum UpArgument {
    /// The camera's axes: x right, y down, z forward
    YDown,
    /// As in glTF and most viewers
    YUp,
    /// As in ROS, CAD and Blender
    ZUp,
}

impl From<UpArgument> for UpAxis {
    fn from(up: UpArgument) -> Self {
        match up {
            UpArgument::YDown => Self::YDown,
            UpArgument::YUp => Self::YUp,
            UpArgument::ZUp => Self::ZUp,
        }
    }
}

/// Frames as asked for: `A..B`, `A..` or `..B`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct FrameRange {
    start: usize,
    end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected A..B, A.. or ..B with frame numbers from 0, not '{text}'");
        let (start, end) = text.split_once("..").ok_or_else(expected)?;
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| expected());
        let start = if start.trim().is_empty() { 0 } else { number(start)? };
        let end = if end.trim().is_empty() { None } else { Some(number(end)?) };
        match end {
            Some(end) if end <= start => Err(format!("'{text}' holds no frame: the last number is not included")),
            _ => Ok(Self { start, end }),
        }
    }
}

impl FrameRange {
    fn within(self, info: &RecordingInfo) -> Result<Range<usize>> {
        let range = self.start..self.end.unwrap_or(info.frames);
        if range.is_empty() || range.end > info.frames {
            let shown = self.end.map_or_else(String::new, |end| end.to_string());
            let (start, last) = (self.start, info.frames.saturating_sub(1));
            bail!("--frames {start}..{shown}: the recording '{}' has frames 0 to {last}", info.name);
        }
        Ok(range)
    }
}

/// A run in words and numbers: what `--json` prints, and what the report is made from.
#[derive(Serialize)]
pub(crate) struct Summary {
    pub(crate) recording: String,
    pub(crate) format: String,
    pub(crate) calibration: String,
    /// Frames of the whole recording.
    pub(crate) recording_frames: usize,
    pub(crate) has_colour: bool,
    pub(crate) has_gyroscope: bool,
    pub(crate) device: String,
    /// `tracked` or `given`.
    pub(crate) poses: &'static str,
    /// Frames that were asked for.
    pub(crate) frames: usize,
    /// Frames that were reached before the end of the run.
    pub(crate) frames_reached: usize,
    pub(crate) posed: usize,
    /// Share of the frames reached that have a pose.
    pub(crate) posed_share: f64,
    pub(crate) poor: usize,
    pub(crate) lost: usize,
    pub(crate) skipped: usize,
    pub(crate) stopped: bool,
    /// What ended the run early, or could not be written.
    pub(crate) errors: Vec<String>,
    pub(crate) seconds: f64,
    pub(crate) frames_per_second: f64,
    pub(crate) median_frame_ms: Option<f64>,
    /// By stage, of the frames that went through it.
    pub(crate) median_stage_ms: BTreeMap<&'static str, f64>,
    /// Blocks in use at the end.
    pub(crate) blocks: Option<u32>,
    /// Surfels at the end, where the map is one of them.
    pub(crate) surfels: Option<u32>,
    /// Device memory of the map.
    pub(crate) map_bytes: u64,
    pub(crate) mesh: Option<MeshSummary>,
    /// Of the final trajectory.
    pub(crate) evaluation: Option<Evaluation>,
    /// Of the poses as they were found, where submaps have moved since.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) live_evaluation: Option<Evaluation>,
    pub(crate) submaps: usize,
    pub(crate) closures: usize,
    pub(crate) keyframes: usize,
    pub(crate) mesh_error: Option<MeshError>,
    /// The frames that were not good, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) not_good: Option<Vec<NotGood>>,
    /// What a user should know, frame by frame.
    pub(crate) messages: Vec<Message>,
    pub(crate) out: PathBuf,
}

#[derive(Serialize)]
pub(crate) struct MeshSummary {
    pub(crate) vertices: usize,
    pub(crate) triangles: usize,
    pub(crate) seconds: f64,
}

/// A frame that was not good.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct NotGood {
    pub(crate) frame: u64,
    /// `poor` or `lost`; or `no-depth`, `no-pose` or `skipped`, where the frame was not tracked.
    pub(crate) verdict: &'static str,
    pub(crate) reasons: Vec<String>,
}

impl NotGood {
    fn of(row: &Row) -> Option<Self> {
        Some(Self { frame: row.frame, verdict: row.trouble()?, reasons: row.reasons.clone() })
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Message {
    pub(crate) frame: u64,
    pub(crate) text: String,
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    // Whatever can be wrong with what was given is found before a device is opened.
    let (settings, resumed) = match &arguments.resume {
        Some(path) => {
            let saved = SavedSession::open(path)?;
            (saved.settings.clone(), Some(saved))
        }
        None => (arguments.resolve_settings()?, None),
    };
    let start = match (&arguments.resume, &arguments.map) {
        (Some(path), _) => Start::Resume(path.clone()),
        (None, Some(path)) => Start::InMap { path: path.clone(), world_from_camera: arguments.start_pose },
        (None, None) => Start::Afresh,
    };
    let recording = recording::open(&arguments.recording, &arguments.open.options())?;
    let info = recording.info().clone();
    let poses = match (&resumed, arguments.poses) {
        (Some(saved), _) => saved.poses,
        (None, PosesArgument::Tracked) => Poses::Tracked,
        (None, PosesArgument::Given) => Poses::Given,
    };
    let frames = match (arguments.frames, &resumed) {
        (Some(range), _) => Some(range.within(&info)?),
        (None, Some(saved)) => {
            let next = usize::try_from(saved.next_frame).unwrap_or(usize::MAX);
            if next >= info.frames {
                bail!("the session was saved after the last frame of '{}', which has {}", info.name, info.frames);
            }
            Some(next..info.frames)
        }
        (None, None) => None,
    };
    let options = SessionOptions { settings, poses, frames: frames.clone(), start };
    Session::check(recording.as_ref(), &options)?;
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("out").join(&info.name));
    prepare_folder(&out, &arguments.recording)?;

    let device = Device::open(&options.settings.device.adapter)?;
    let mut session = Session::new(&device, recording, &options)?;
    let mut log = Log::create(&out, &info, session.slam().settings())?;
    log.write_poses_before(session.slam().trajectory())?;
    log.explain = arguments.explain;
    let stop = console::StopOnCtrlC::new(session.stop_switch(), "stopping; mesh and report will be written");
    let bar = console::bar(frames.map_or(info.frames, |f| f.len()) as u64, "frames", arguments.quiet);
    let ended = log.follow(&mut session, &bar)?;
    bar.finish_and_clear();

    let mut errors: Vec<Error> = log.failure.take().into_iter().chain(ended.error.clone().map(Error::msg)).collect();
    let mut keep = |result: Result<()>| errors.extend(result.err());
    keep(log.timings.finish(&ended.reports).context("cannot write timings.csv"));
    if let Some(path) = &arguments.save {
        keep(session.slam().save(path).with_context(|| format!("the map is not saved in '{}'", path.display())));
    }
    let settled = session.slam().settle();
    if let Some(happening) = &settled {
        log.say(log.last_frame(), happening.to_string());
        keep(log.write_corrected(&out, &session.slam().corrected_trajectory()));
    }
    let mut mesh = None;
    if !arguments.no_mesh {
        keep(write_mesh(&mut session, &out, arguments).map(|written| mesh = Some(written)));
    }
    drop(stop);

    let trajectory = session.slam().corrected_trajectory();
    let mut evaluate = |trajectory: &Trajectory| match (&info.ground_truth, poses) {
        (Some(truth), Poses::Tracked) => evaluation::evaluate(trajectory, truth, evaluation::DEFAULT_TOLERANCE_NS)
            .map_err(|error| log.say(log.last_frame(), format!("no ATE: {error}")))
            .ok(),
        _ => None,
    };
    let evaluation = evaluate(&trajectory);
    let live_evaluation = settled.is_some().then(|| evaluate(session.slam().trajectory())).flatten();
    let truth_from_mesh = match (&info.ground_truth, poses) {
        (_, Poses::Given) => Some(Se3::IDENTITY),
        (Some(truth), Poses::Tracked) => mesh_error::align_poses(&trajectory, truth),
        (None, Poses::Tracked) => None,
    };
    let scene = mesh_error::scene_of(&arguments.recording);
    let mesh_error = mesh.as_ref().zip(truth_from_mesh).zip(scene).and_then(|(((mesh, _), truth_from_mesh), scene)| {
        MeshError::measure(mesh, &scene, &truth_from_mesh, session.slam().settings().map.voxel_size_m)
    });

    let rows = log.timings.rows();
    let median_of = |value: &dyn Fn(&Row) -> Option<f64>| timings::median(rows.iter().filter_map(value));
    let median_stage = |(i, stage)| Some((stage, median_of(&|row: &Row| row.stage_ms[i])?));
    let mut summary = Summary {
        recording: info.name.clone(),
        format: info.format.to_string(),
        calibration: info.calibration_source.clone(),
        recording_frames: info.frames,
        has_colour: info.has_colour,
        has_gyroscope: info.has_gyroscope,
        device: device.name().to_string(),
        poses: if poses == Poses::Tracked { "tracked" } else { "given" },
        frames: ended.frames,
        frames_reached: rows.len(),
        posed: ended.posed,
        posed_share: ended.posed as f64 / rows.len().max(1) as f64,
        poor: ended.poor,
        lost: ended.lost,
        skipped: ended.skipped,
        stopped: ended.stopped,
        errors: errors.iter().map(|e| format!("{e:#}")).collect(),
        seconds: ended.seconds,
        frames_per_second: rows.len() as f64 / ended.seconds.max(1e-9),
        median_frame_ms: median_of(&|row| row.total_ms),
        median_stage_ms: STAGES.into_iter().enumerate().filter_map(median_stage).collect(),
        blocks: rows.iter().rev().find_map(|row| row.blocks),
        surfels: rows.iter().rev().find_map(|row| row.surfels),
        map_bytes: session.slam().map_bytes(),
        mesh: mesh.as_ref().map(|(mesh, seconds)| MeshSummary {
            vertices: mesh.positions.len(),
            triangles: mesh.triangles.len(),
            seconds: *seconds,
        }),
        evaluation,
        live_evaluation,
        submaps: session.slam().submaps().len().max(1),
        closures: session.slam().submap_links().iter().filter(|link| link.closure).count(),
        keyframes: session.slam().keyframes().len(),
        mesh_error,
        not_good: arguments.explain.then(|| rows.iter().filter_map(NotGood::of).collect()),
        messages: log.messages.clone(),
        out: out.clone(),
    };
    if let Err(error) = write_metrics(&summary) {
        summary.errors.push(format!("{error:#}"));
    }
    let pictures = pictures::of(session.slam(), mesh.as_ref().map(|(mesh, _)| mesh));
    let submaps = session.slam().submaps().to_vec();
    let in_world = |keyframe: &Keyframe| {
        let submap = submaps.get(usize::from(keyframe.submap)).map(|submap| submap.world_from_submap);
        (submap.unwrap_or_default() * keyframe.submap_from_camera).translation
    };
    let keyframes: Vec<_> = session.slam().keyframes().iter().map(in_world).collect();
    let page = report::Report {
        submaps: &submaps,
        links: &session.slam().submap_links(),
        keyframes: &keyframes,
        summary: &summary,
        rows,
        trajectory: &trajectory,
        info: &info,
        pictures: &pictures,
        settings: &session.slam().settings().to_toml(),
    };
    if let Err(error) = report::write(&out.join("report.html"), &page) {
        summary.errors.push(format!("{error:#}"));
    }

    if arguments.json {
        console::print_json(&summary)?;
    } else if !arguments.quiet {
        console::print(&summary)?;
    }
    for error in &summary.errors {
        console::error(&anyhow!("{error}"));
    }
    Ok(match (summary.errors.is_empty(), summary.stopped) {
        (false, _) => 1,
        (true, true) => console::INTERRUPTED,
        (true, false) => 0,
    })
}

impl Arguments {
    fn resolve_settings(&self) -> Result<Settings> {
        let file = match &self.settings {
            None => None,
            Some(path) => {
                let name = path.display().to_string();
                let text = fs::read_to_string(path).with_context(|| format!("cannot read the settings '{name}'"))?;
                Some((name, text))
            }
        };
        let file = match (file, &self.map) {
            (None, Some(path)) => {
                let reader = MapReader::open(path)?;
                Some((format!("the settings in '{}'", path.display()), reader.header().settings.clone()))
            }
            (file, _) => file,
        };
        let file = file.as_ref().map(|(name, text)| (name.as_str(), text.as_str()));
        let mut settings = Settings::resolve(file, &self.overrides)?;
        if let Some(tracker) = &self.tracker {
            settings.tracker.set_string(tracker)?;
        }
        if let Some(fusion) = self.fusion {
            settings.map.fuse = fusion == Switch::On;
        }
        if let Some(device) = &self.device {
            settings.device.adapter.clone_from(device);
        }
        match self.mode {
            Some(ModeArgument::Basic) => settings.mode = Mode::Basic,
            Some(ModeArgument::LoopClosure) => settings.mode = Mode::LoopClosure,
            Some(ModeArgument::Surfels) => settings.mode = Mode::Surfels,
            Some(ModeArgument::SurfelsLoopClosure) => settings.mode = Mode::SurfelsLoopClosure,
            None => {}
        }
        Ok(settings)
    }
}

/// Makes the folder, finds out whether it can be written, and removes what an earlier run wrote at its end, so that
/// results of two runs are never mixed.
fn prepare_folder(out: &Path, recording: &Path) -> Result<()> {
    let shown = out.display();
    if out.exists() && !out.is_dir() {
        bail!("the output '{shown}' is a file; name a folder");
    }
    fs::create_dir_all(out).with_context(|| format!("cannot make the output folder '{shown}'"))?;
    if out.canonicalize().ok().is_some_and(|out| recording.canonicalize().is_ok_and(|recording| recording == out)) {
        bail!("the output '{shown}' is the recording itself; name another folder");
    }
    let probe = out.join(format!(".itm-{}.part", std::process::id()));
    let written = OpenOptions::new().write(true).create_new(true).open(&probe);
    written.with_context(|| format!("cannot write to the output folder '{shown}'"))?;
    fs::remove_file(&probe).with_context(|| format!("cannot remove '{}'", probe.display()))?;
    let meshes = MeshFormat::value_variants().iter().map(|format| format.file_name());
    for name in meshes.chain(["report.html", "metrics.json"]) {
        let path = out.join(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("cannot replace '{}'", path.display()));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Writes what was measured against the truth, where anything was.
fn write_metrics(summary: &Summary) -> Result<()> {
    let Summary { frames_reached, posed, posed_share, poor, lost, evaluation, mesh_error, out, .. } = summary;
    let Summary { live_evaluation, submaps, closures, keyframes, .. } = summary;
    if evaluation.is_none() && mesh_error.is_none() {
        return Ok(());
    }
    let path = out.join("metrics.json");
    let metrics = json!({
        "frames": frames_reached,
        "posed": posed,
        "posed_share": posed_share,
        "poor": poor,
        "lost": lost,
        "evaluation": evaluation,
        "live_evaluation": live_evaluation,
        "submaps": submaps,
        "closures": closures,
        "keyframes": keyframes,
        "mesh_error": mesh_error,
    });
    fs::write(&path, format!("{metrics:#}\n")).with_context(|| format!("cannot write '{}'", path.display()))
}

/// Extracts the mesh and writes it; returns it with the seconds that took.
fn write_mesh(session: &mut Session, out: &Path, arguments: &Arguments) -> Result<(Mesh, f64)> {
    let started = Instant::now();
    let bar = console::bar(0, "blocks meshed", arguments.quiet);
    let mesh = session.mesh(&mut |done, all| {
        bar.set_length(all.into());
        bar.set_position(done.into());
    });
    bar.finish_and_clear();
    let mesh = mesh.context("no mesh")?;
    let options = MeshOptions { up: arguments.up.map(UpAxis::from) };
    for format in &arguments.mesh_format {
        itm_io::mesh::write(&out.join(format.file_name()), &mesh, &options)?;
    }
    Ok((mesh, started.elapsed().as_secs_f64()))
}

/// Follows a session's events: what they say goes into files, onto the progress bar and into messages.
struct Log {
    trajectory: TumWriter,
    timings: Timings<BufWriter<File>>,
    info: RecordingInfo,
    messages: Vec<Message>,
    /// Why results could not be written any more.
    failure: Option<Error>,
    /// Whether each frame that was not good is told.
    explain: bool,
    lost: bool,
    full: bool,
    dropped: bool,
    unstored: bool,
    /// When the latest frames were done.
    done: VecDeque<Instant>,
    blocks: u32,
    /// Surfels, where the map is one of them.
    surfels: Option<u32>,
}

/// Frames that the frame rate shown is an average over.
const RATE_OVER: usize = 30;

impl Log {
    /// Creates the files that grow with the run, and writes the settings.
    fn create(out: &Path, info: &RecordingInfo, settings: &Settings) -> Result<Self> {
        let at = |name: &str| out.join(name);
        let failed = |path: &Path| format!("cannot write '{}'", path.display());
        let path = at("settings.toml");
        fs::write(&path, settings.to_toml()).with_context(|| failed(&path))?;
        let time = if info.has_timestamps { TimeColumn::Seconds } else { TimeColumn::FrameNumber };
        let trajectory = TumWriter::create(&at("trajectory.txt"), time)?;
        let path = at("timings.csv");
        let file = File::create(&path).with_context(|| failed(&path))?;
        Ok(Self {
            trajectory,
            timings: Timings::new(BufWriter::new(file)).with_context(|| failed(&path))?,
            info: info.clone(),
            messages: Vec::new(),
            failure: None,
            explain: false,
            lost: false,
            full: false,
            dropped: false,
            unstored: false,
            done: VecDeque::new(),
            blocks: 0,
            surfels: None,
        })
    }

    /// Writes the poses of a session that goes on, so that the file holds all of them.
    fn write_poses_before(&mut self, before: &Trajectory) -> Result<()> {
        for (pose, place) in before.poses().iter().zip(0..) {
            let number = self.info.image_number(pose.timestamp).unwrap_or(place);
            self.trajectory.write(number, pose)?;
        }
        Ok(())
    }

    /// Writes the trajectory with the submaps where they lie at the end in place of the live one, which is kept beside it.
    fn write_corrected(&self, out: &Path, trajectory: &Trajectory) -> Result<()> {
        let (path, live) = (out.join("trajectory.txt"), out.join("trajectory_live.txt"));
        fs::rename(&path, &live).with_context(|| format!("cannot keep '{}'", live.display()))?;
        let time = if self.info.has_timestamps { TimeColumn::Seconds } else { TimeColumn::FrameNumber };
        let mut writer = TumWriter::create(&path, time)?;
        for (pose, place) in trajectory.poses().iter().zip(0..) {
            writer.write(self.info.image_number(pose.timestamp).unwrap_or(place), pose)?;
        }
        Ok(())
    }

    /// Runs the session to its end. Where results cannot be written any more, it is stopped, and `failure` says why.
    fn follow(&mut self, session: &mut Session, bar: &ProgressBar) -> Result<itm_slam::Summary> {
        let stop = session.stop_switch();
        while let Some(event) = session.next() {
            let kept = match event {
                Event::Frame { result, total_ms } => {
                    let kept = self.frame(&result, total_ms);
                    bar.set_message(self.state(&result, session.slam().capacity()));
                    kept
                }
                Event::Skipped { index, reason } => {
                    // The reason may name the frame already.
                    let reason = reason.strip_prefix(&format!("frame {index}: ")).unwrap_or(&reason);
                    self.say(index as u64, format!("skipped: {reason}"));
                    self.timings.skipped(index, reason).context("cannot write timings.csv")
                }
                // The log has said it.
                Event::Warning(warning) => {
                    self.messages.push(Message { frame: self.last_frame(), text: warning.to_string() });
                    continue;
                }
                Event::Finished(summary) => {
                    summary.reports.iter().for_each(|report| self.tell_notices(report));
                    return Ok(summary);
                }
            };
            bar.inc(1);
            if let Err(error) = kept
                && self.failure.is_none()
            {
                self.failure = Some(error);
                stop.store(true, Ordering::Relaxed);
            }
        }
        bail!("the run ended without a summary")
    }

    fn frame(&mut self, result: &FrameResult, total_ms: f64) -> Result<()> {
        // Both are tried: a frame whose pose could not be written still counts.
        let posed = self.pose(result);
        let timed = self.timings.frame(result, total_ms).context("cannot write timings.csv");
        self.tell(result);
        posed.and(timed)
    }

    fn pose(&mut self, result: &FrameResult) -> Result<()> {
        let Some(world_from_camera) = result.world_from_camera else { return Ok(()) };
        // Where there are no times, the number that the recording's own files and ground truth count by.
        let number = self.info.image_number(result.timestamp).unwrap_or(result.index);
        Ok(self.trajectory.write(number, &StampedPose { timestamp: result.timestamp, world_from_camera })?)
    }

    /// Tells what is new about the state of tracking and of the map.
    fn tell(&mut self, result: &FrameResult) {
        let news = match (&result.status, self.lost) {
            (FrameStatus::Lost { reason }, false) => {
                self.lost = true;
                Some(format!("tracking lost: {reason}"))
            }
            (FrameStatus::Tracked, true) => {
                self.lost = false;
                Some("tracked again".into())
            }
            _ => None,
        };
        match news {
            // Each frame is explained instead, which says as much.
            Some(text) if self.explain => self.messages.push(Message { frame: result.index, text }),
            Some(text) => self.say(result.index, text),
            None => {}
        }
        if self.explain
            && let Some(row) = self.timings.rows().last()
            && let Some(trouble) = row.trouble()
        {
            console::note(format_args!("frame {}: {trouble}: {}", row.frame, row.why()));
        }
        for happening in &result.happenings {
            match happening {
                Happening::Keyframe { .. } => {}
                _ => self.say(result.index, happening.to_string()),
            }
        }
        if let Some(report) = &result.report {
            self.tell_notices(report);
        }
    }

    /// A full map says so each frame; once is enough.
    fn tell_notices(&mut self, report: &FrameReport) {
        let mut full = false;
        for notice in &report.notices {
            let known = match notice {
                Notice::Waiting { .. } => {
                    full = true;
                    self.full
                }
                Notice::Dropped { .. } | Notice::SurfelsDropped { .. } => std::mem::replace(&mut self.dropped, true),
                Notice::HostStore { .. } => std::mem::replace(&mut self.unstored, true),
            };
            if !known {
                self.say(report.index, notice.to_string());
            }
        }
        self.full = full;
    }

    fn say(&mut self, frame: u64, text: String) {
        console::note(format_args!("frame {frame}: {text}"));
        self.messages.push(Message { frame, text });
    }

    fn last_frame(&self) -> u64 {
        self.timings.rows().last().map_or(0, |row| row.frame)
    }

    /// Frame rate, state of tracking and use of blocks, for the progress bar.
    fn state(&mut self, result: &FrameResult, capacity: u32) -> String {
        let now = Instant::now();
        self.done.push_back(now);
        if self.done.len() > RATE_OVER {
            self.done.pop_front();
        }
        let seconds = self.done.front().map_or(0.0, |first| (now - *first).as_secs_f64());
        let rate = (self.done.len() - 1) as f64 / seconds.max(1e-9);
        if let Some(report) = &result.report {
            self.blocks = report.record.blocks.saturating_sub(report.record.free_blocks);
            self.surfels = report.surfels.map(|record| record.used.saturating_sub(record.free));
        }
        let status = match &result.status {
            FrameStatus::Placed => "placed",
            FrameStatus::Tracked => "tracked",
            FrameStatus::Poor { .. } => "poor",
            FrameStatus::Lost { .. } => "LOST",
            FrameStatus::NoPose => "no pose",
            FrameStatus::NoDepth => "no depth",
        };
        let size = match self.surfels {
            Some(surfels) => format!("{surfels} surfels"),
            None => format!("{} of {capacity} blocks", self.blocks),
        };
        format!("· {rate:.1} frames/s · {status} · {size}")
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { frames, frames_reached, posed, poor, lost, skipped, .. } = self;
        let share = self.posed_share * 100.0;
        if self.stopped {
            writeln!(f, "stopped after {frames_reached} of {frames} frames")?;
        }
        write!(f, "frames with a pose: {posed} of {frames_reached} ({share:.1} %); ")?;
        write!(f, "{poor} poor, {lost} lost, {skipped} skipped")?;
        if self.not_good.is_none() && poor + lost > 0 {
            write!(f, " (--explain says which and why)")?;
        }
        write!(f, "\ntime: {:.1} s, {:.1} frames/s", self.seconds, self.frames_per_second)?;
        if let Some(ms) = self.median_frame_ms {
            write!(f, ", median {ms:.1} ms a frame on {}", self.device)?;
        }
        if let Some(surfels) = self.surfels {
            write!(f, "\nmap: {surfels} surfels, {} MiB on the device", self.map_bytes >> 20)?;
        }
        if let Some(blocks) = self.blocks {
            write!(f, "\nmap: {blocks} blocks, {} MiB on the device", self.map_bytes >> 20)?;
        }
        match &self.mesh {
            Some(mesh) if mesh.triangles == 0 => write!(f, "\nmesh: empty, as nothing was fused")?,
            Some(MeshSummary { vertices, triangles, seconds }) => {
                write!(f, "\nmesh: {vertices} vertices, {triangles} triangles in {seconds:.1} s")?;
            }
            None => {}
        }
        if let Some(evaluation) = &self.evaluation {
            let (ate, rpe) = (evaluation.ate.rmse * 1e3, evaluation.rpe_translation.rmse * 1e3);
            if let Some(live) = &self.live_evaluation {
                write!(f, "\nlive ATE: {:.2} mm rmse, before the submaps were corrected", live.ate.rmse * 1e3)?;
            }
            let turn = evaluation.rpe_rotation.rmse.to_degrees();
            write!(f, "\nATE: {ate:.2} mm rmse over {} poses ({share:.1} % of the frames have one)", evaluation.pairs)?;
            write!(f, "\nRPE: {rpe:.2} mm, {turn:.3}° rmse a frame")?;
        }
        if let Some(MeshError { median_mm, percentile_99_mm, within_voxel, vertices }) = &self.mesh_error {
            let within = within_voxel * 100.0;
            write!(
                f,
                "\nmesh error: {median_mm:.2} mm median, {percentile_99_mm:.2} mm 99th percentile, {within:.1} % \
                 within a voxel ({vertices} vertices)"
            )?;
        }
        write!(f, "\nresults: {}", self.out.display())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_frames() {
        let range = |start, end| Ok(FrameRange { start, end });
        assert_eq!("2..5".parse(), range(2, Some(5)));
        assert_eq!("2..".parse(), range(2, None));
        assert_eq!("..5".parse(), range(0, Some(5)));
        assert_eq!("..".parse(), range(0, None));
        for bad in ["", "5", "5..5", "6..5", "-1..5", "a..b", "1..2..3", "1..=2", "0..0"] {
            assert!(bad.parse::<FrameRange>().is_err(), "{bad}");
        }
    }

    #[test]
    fn results_of_an_earlier_run_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("a/b");
        prepare_folder(&out, folder.path()).unwrap();
        for name in ["mesh.ply", "notes.txt", "trajectory.txt"] {
            fs::write(out.join(name), "").unwrap();
        }
        prepare_folder(&out, folder.path()).unwrap();
        assert!(!out.join("mesh.ply").exists() && out.join("notes.txt").exists());
        let error = prepare_folder(folder.path(), folder.path()).unwrap_err().to_string();
        assert!(error.contains("is the recording itself"), "{error}");
    }
}
