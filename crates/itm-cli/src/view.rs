//! `itm view`.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Error, Result};
use clap::Args;
use itm_slam::{Event, Poses, Session};
use itm_viewer::{Keeper, KeeperFor, Options};

use crate::console;
use crate::log::Log;
use crate::recordings::RecordingArguments;
use crate::render::Kind;
use crate::results::{MeshFormat, Results, prepare_folder};
use crate::settings::{FrameRange, SettingsArguments};

/// Watch a reconstruction in a window, or look at a saved map
///
/// A recording is reconstructed as 'itm run' does it, with the same settings, while the map can be looked at from anywhere. A map
/// (.itm) can be looked at and meshed, and a recording tracked in it or gone on with. Without a path the window says what to do; files can be dropped on it.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm view rgbd_dataset_freiburg1_desk
  itm view room --mode loop-closure --free
  itm view room.itm
  itm view room --paused --set map.voxel_size_m=0.01

? in the window shows all keys. Exit status: 0, or 1 where no window can be opened.")]
pub(crate) struct Arguments {
    /// Folder of a recording, an MCAP file, a map, or the folder that a run wrote
    path: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArguments,
    /// Only these frames, by their place in the recording from 0; B is not included
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    #[command(flatten)]
    open: RecordingArguments,
    /// Folder for the results, as 'itm run' writes them, of a second reconstruction in the same window with a number behind its
    /// name [default: out/NAME-view, with the recording's name]
    #[arg(short, long)]
    out: Option<PathBuf>,
    /// Keep no results but those that are asked for in the window
    #[arg(long, conflicts_with = "out")]
    no_results: bool,
    /// Wait for the first frame until told to go on
    #[arg(long)]
    paused: bool,
    /// Begin with the free view, in place of the recording's camera
    #[arg(long)]
    free: bool,
    /// How the map is shown at first
    #[arg(long, value_enum, default_value_t = Kind::Phong)]
    kind: Kind,
    /// Write a picture of the window to this PNG file once the last frame is done, and close it
    #[arg(long, value_name = "FILE", conflicts_with = "paused")]
    picture: Option<PathBuf>,
    /// Size of the window
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x800", value_parser = size_from_str)]
    size: (f32, f32),
}

fn size_from_str(text: &str) -> Result<(f32, f32), String> {
    let number = |text: &str| text.parse::<u16>().ok().filter(|n| (100..=16_384).contains(n)).map(f32::from);
    let size = text.split_once('x').and_then(|(width, height)| Some((number(width)?, number(height)?)));
    size.ok_or_else(|| format!("expected WIDTHxHEIGHT in points, as 1280x800, not '{text}'"))
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let keeper_for: KeeperFor = {
        let (out, poses) = (arguments.out.clone(), arguments.settings.poses());
        let mut used = HashSet::new();
        Box::new(move |recording, session| {
            let name = format!("{}-view", session.info().name);
            let out = out.clone().unwrap_or_else(|| Path::new("out").join(name));
            Ok(Box::new(Kept::begin(recording, session, unused(&mut used, &out), poses).map_err(told)?))
        })
    };
    let stop = Arc::<AtomicBool>::default();
    let _on_ctrl_c = console::StopOnCtrlC::new(Arc::clone(&stop), "closing; what was reconstructed is written");
    itm_viewer::run(Options {
        stop,
        keeper_for: (!arguments.no_results).then_some(keeper_for),
        path: arguments.path.clone(),
        recordings: arguments.open.options(),
        settings: arguments.settings.resolve(None)?,
        poses: arguments.settings.poses(),
        frames: arguments.frames.map_or((0, None), FrameRange::ends),
        run: !arguments.paused,
        free_view: arguments.free,
        shading: arguments.kind.shading(),
        picture: arguments.picture.clone(),
        size: arguments.size,
    })?;
    Ok(0)
}

/// A folder that this window has written no results into: the one asked for, or one whose name goes on with a number.
fn unused(used: &mut HashSet<PathBuf>, asked: &Path) -> PathBuf {
    let mut folder = asked.to_owned();
    for number in 2.. {
        if used.insert(folder.clone()) {
            break;
        }
        let name = asked.file_name().unwrap_or_default().to_string_lossy();
        folder = asked.with_file_name(format!("{name}-{number}"));
    }
    folder
}

fn told(error: Error) -> String {
    format!("{error:#}")
}

/// The results of a reconstruction in the window, as a run without one keeps them.
struct Kept {
    log: Log,
    results: Results,
    ended: Option<itm_slam::Summary>,
}

impl Kept {
    fn begin(recording: &Path, session: &Session, out: PathBuf, poses: Poses) -> Result<Self> {
        prepare_folder(&out, recording)?;
        let mut log = Log::create(&out, session.info(), session.slam().settings())?;
        log.write_poses_before(session.slam().trajectory())?;
        let results = Results {
            recording: recording.to_owned(),
            out,
            device: session.slam().device().name().to_string(),
            poses,
            mesh_formats: vec![MeshFormat::Ply],
            up: None,
            save: None,
            explain: false,
            quiet: true,
        };
        Ok(Self { log, results, ended: None })
    }
}

impl Keeper for Kept {
    fn event(&mut self, event: &Event, _session: &mut Session) -> Result<(), String> {
        if let Event::Finished(summary) = event {
            self.ended = Some(summary.clone());
        }
        self.log.take(event).map_err(told)
    }

    fn finish(&mut self, session: &mut Session) -> Result<PathBuf, String> {
        let ended = self.ended.take().unwrap_or_default();
        let summary = self.results.write(session, &mut self.log, &ended);
        // As the program says them without a window; what could not be written is said in the window too.
        console::note(&summary);
        if summary.errors.is_empty() { Ok(self.results.out.clone()) } else { Err(summary.errors.join("; ")) }
    }
}
