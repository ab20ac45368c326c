//! `itm convert`.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use itm_io::recording::{self, McapWriter, ReadAhead};
use serde_json::json;

use crate::console;
use crate::recordings::RecordingArguments;

/// Write a recording as an MCAP file, without loss
///
/// Messages are of Foxglove's schemas, which are embedded, so that Foxglove and other readers of MCAP show them: depth as
/// 16UC1 (millimetres) where the recording has such values, else as 32FC1 (metres), colour as PNG, cameras, true poses,
/// and a gyroscope's readings. A run over the file repeats one over the recording to the byte.
#[derive(Args)]
#[command(after_help = "\
Examples:
  itm convert rgbd_dataset_freiburg1_desk desk.mcap
  itm convert bag.mcap scan.mcap --topics depth=/stereo/depth,color=none
  itm run desk.mcap

The file takes its name once it is whole; Ctrl-C leaves none, or the one that was there.
Exit status: 0 complete, 130 stopped by Ctrl-C, 1 error, 2 bad command line.")]
pub(crate) struct Arguments {
    /// Recording, in any format that itm run takes
    recording: PathBuf,
    /// File to write; its name ends in .mcap
    out: PathBuf,
    #[command(flatten)]
    open: RecordingArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Show no progress
    #[arg(short, long)]
    quiet: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let out = &arguments.out;
    let shown = out.display();
    if out.extension().is_none_or(|end| !end.eq_ignore_ascii_case("mcap")) {
        bail!("cannot write '{shown}': expected a name that ends in .mcap");
    }
    let same = |path: &PathBuf| path.canonicalize().is_ok_and(|path| out.canonicalize().is_ok_and(|out| out == path));
    if same(&arguments.recording) {
        bail!("the output '{shown}' is the recording itself; name another file");
    }
    let recording = recording::open(&arguments.recording, &arguments.open.options())?;
    let info = recording.info().clone();
    if info.has_imu_orientation {
        console::note("warning: orientations of an inertial sensor have no place in the file and are left out");
    }
    let mut writer = McapWriter::create(out, &info)?;
    let stop = Arc::new(AtomicBool::new(false));
    let _ends_here = console::StopOnCtrlC::new(Arc::clone(&stop), "stopping; no file is written");
    let bar = console::bar(info.frames as u64, "frames", arguments.quiet);
    let (mut written, mut skipped) = (0_usize, 0_usize);
    for frame in ReadAhead::new(recording, 0..info.frames, ReadAhead::DEFAULT_FRAMES) {
        if stop.load(Ordering::Relaxed) {
            bar.finish_and_clear();
            return Ok(console::INTERRUPTED);
        }
        match frame {
            Ok(frame) => {
                writer.write(&frame)?;
                written += 1;
            }
            Err(error) => {
                console::note(format_args!("skipped: {error}"));
                skipped += 1;
            }
        }
        bar.inc(1);
    }
    if written == 0 {
        bail!("none of the {} frames of '{}' can be read", info.frames, arguments.recording.display());
    }
    writer.finish()?;
    bar.finish_and_clear();
    let bytes = std::fs::metadata(out).with_context(|| format!("cannot read '{shown}'"))?.len();
    if arguments.json {
        console::print_json(&json!({ "file": out, "frames": written, "skipped": skipped, "bytes": bytes }))?;
    } else if !arguments.quiet {
        let left_out = if skipped > 0 { format!(", {skipped} could not be read") } else { String::new() };
        console::print(format_args!("{shown}: {written} frames{left_out}, {:.1} MB", bytes as f64 * 1e-6))?;
    }
    Ok(0)
}
