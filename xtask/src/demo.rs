//! `demo`: from a checkout to a measured reconstruction, with one command.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};

use crate::setup::{self, Installing, cargo};
use crate::{steps, workspace_root};

/// Builds the program, makes a synthetic recording of `frames` frames and reconstructs it, both below `out`.
pub(crate) fn demo(installing: Installing, frames: u32, out: Option<&Path>) -> Result<()> {
    setup::adapter(installing)?;
    let out = output_folder(out)?;
    let (recording, result) = (out.join("recording"), out.join("result"));

    heading("building the program (a few minutes the first time)");
    let build = steps::run(cargo().args(["build", "--release", "--package", "itm-cli"]))?;

    heading("adapters that it can run on");
    if steps::run(&mut itm(&["devices".as_ref()])).is_err() {
        if !setup::fall_back_to_software(installing)? {
            bail!("the installed Vulkan drivers offer no adapter: `vulkaninfo --summary` may say why");
        }
        steps::run(&mut itm(&["devices".as_ref()]))?;
    }

    heading(&format!("making a synthetic recording of {frames} frames"));
    let synth = steps::run(&mut itm(&[
        "synth".as_ref(),
        recording.as_ref(),
        "--frames".as_ref(),
        frames.to_string().as_ref(),
    ]))?;

    heading("reconstructing it");
    let run = steps::run(&mut itm(&["run".as_ref(), recording.as_ref(), "-o".as_ref(), result.as_ref()]))?;

    heading("done");
    let seconds = |time: Duration| format!("{:.1} s", time.as_secs_f64());
    println!("times      build {}, recording {}, reconstruction {}", seconds(build), seconds(synth), seconds(run));
    println!("recording  {}", shown(&recording));
    for name in ["report.html", "mesh.ply", "trajectory.txt"] {
        let file = result.join(name);
        if !file.is_file() {
            bail!("the run did not write {}", shown(&file));
        }
        println!("{:<10} {}", name.split('.').next().unwrap_or(name), shown(&file));
    }
    Ok(())
}

/// The `itm` program, through cargo, which knows where the release build lies.
fn itm(arguments: &[&std::ffi::OsStr]) -> Command {
    let mut command = cargo();
    command.args(["run", "--quiet", "--release", "--package", "itm-cli", "--bin", "itm", "--"]).args(arguments);
    command
}

/// An absolute folder without an earlier recording or result. Those of the default folder, which are this command's own,
/// are removed; elsewhere nothing is.
fn output_folder(out: Option<&Path>) -> Result<PathBuf> {
    let parts = ["recording", "result"];
    let Some(out) = out else {
        let out = workspace_root().join("out/demo");
        for part in parts.map(|part| out.join(part)).iter().filter(|part| part.exists()) {
            std::fs::remove_dir_all(part)
                .with_context(|| format!("can't remove {} of an earlier demo", shown(part)))?;
        }
        return Ok(out);
    };
    let out = std::path::absolute(out).with_context(|| format!("{} is no folder's name", out.display()))?;
    if let Some(part) = parts.map(|part| out.join(part)).iter().find(|part| part.exists()) {
        bail!("{} exists already: name another folder, or remove it", shown(part));
    }
    Ok(out)
}

fn heading(text: &str) {
    println!("\n== {text}");
}

/// A path as the user would type it here.
fn shown(path: &Path) -> String {
    let here = std::env::current_dir().unwrap_or_default();
    path.strip_prefix(here).unwrap_or(path).display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_user_has_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(output_folder(Some(folder.path())).unwrap(), folder.path());
        let result = folder.path().join("result");
        std::fs::create_dir(&result).unwrap();
        let error = output_folder(Some(folder.path())).unwrap_err();
        assert!(error.to_string().contains("exists already"), "{error}");
        assert!(result.exists());
    }

    #[test]
    fn paths_below_the_current_folder_are_shown_without_it() {
        let here = std::env::current_dir().unwrap();
        assert_eq!(shown(&here.join("out/demo")), Path::new("out/demo").display().to_string());
    }
}
