//! `itm run`.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use clap::{Args, ValueEnum};
use itm_core::{Se3, Settings};
use itm_io::mesh::UpAxis;
use itm_io::recording;
use itm_slam::{Device, SavedSession, Session, SessionOptions, Start};

use crate::console;
use crate::log::Log;
use crate::recordings::RecordingArguments;
use crate::results::{MeshFormat, Results, UpArgument, prepare_folder};
use crate::settings::{FrameRange, SettingsArguments};

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
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    #[command(flatten)]
    settings: SettingsArguments,
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
    let poses = match (&resumed, arguments.settings.poses()) {
        (Some(saved), _) => saved.poses,
        (None, poses) => poses,
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
    let results = Results {
        recording: arguments.recording.clone(),
        out,
        device: device.name().to_string(),
        poses,
        mesh_formats: if arguments.no_mesh { Vec::new() } else { arguments.mesh_format.clone() },
        up: arguments.up.map(UpAxis::from),
        save: arguments.save.clone(),
        explain: arguments.explain,
        quiet: arguments.quiet,
    };
    let summary = results.write(&mut session, &mut log, &ended);
    drop(stop);

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
        let mut settings = self.settings.resolve(self.map.as_deref())?;
        if let Some(fusion) = self.fusion {
            settings.map.fuse = fusion == Switch::On;
        }
        Ok(settings)
    }
}
