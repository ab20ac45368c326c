//! `train-verdict`: trains the classifier of tracking's verdicts, and measures it on recordings that it has not seen.

use std::process::Command;

use anyhow::Result;

use crate::setup::{self, Installing, cargo};
use crate::{steps, workspace_root};

/// Where the classifier lies, from the workspace's root.
const CLASSIFIER: &str = "assets/verdict.toml";

/// Trains, unless it is only to be measured, and measures.
pub(crate) fn train(installing: Installing, measure_only: bool, in_doubt_alone: bool) -> Result<()> {
    setup::adapter(installing)?;
    if !measure_only {
        let to = workspace_root().join(CLASSIFIER);
        steps::run(program().arg("train").arg(to).args(in_doubt_alone.then_some("in-doubt")))?;
    }
    // Built anew by cargo, with the classifier that was just written.
    steps::run(program().arg("measure"))?;
    Ok(())
}

fn program() -> Command {
    let mut command = cargo();
    command.args(["run", "--quiet", "--release", "--package", "itm-tests", "--example", "train_verdict", "--"]);
    command.env("NODEVICE_SELECT", "1");
    command
}
