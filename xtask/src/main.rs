//! The tasks of the workspace: `cargo xtask setup | test | ci | python | demo | accuracy`.
//!
//! Plain Rust instead of scripts, and none of the workspace's own crates, so that it builds in seconds on a machine
//! that has nothing but a Rust toolchain. The rules of the workspace that no compiler checks are tests of this package
//! (`tests/workspace`).
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program, and what it prints is for people")]

mod accuracy;
mod checks;
mod demo;
mod distribution;
mod python;
mod setup;
mod steps;
mod verdict;
mod vulkan;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, Parser, Subcommand};

use crate::setup::Installing;

/// The tasks of the itm workspace.
#[derive(Parser)]
#[command(bin_name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Look for a Vulkan adapter, and install the software driver where there is none
    Setup(SetupArguments),
    /// Check formatting, lints and documentation, then run every test and doc test, those of the Python package too
    Test(CheckArguments),
    /// What `test` does, and the licences and duplicates of all dependencies where cargo-deny is installed
    Ci(CheckArguments),
    /// Build the Python package in target/python, and run its tests and type checks, as `test` does at its end
    Python(SetupArguments),
    /// Make a synthetic recording, reconstruct it, and say how good the result is
    Demo(DemoArguments),
    /// Measure every tracker and extension on synthetic and real recordings, and write docs/ACCURACY.md's tables
    Accuracy(AccuracyArguments),
    /// Train the classifier of tracking's verdicts (assets/verdict.toml), and measure it on other recordings
    TrainVerdict(TrainArguments),
}

#[derive(Args)]
struct TrainArguments {
    #[command(flatten)]
    setup: SetupArguments,
    /// Leave the classifier as it is, and only measure it
    #[arg(long)]
    measure: bool,
    /// Train what judges frames after a loss, and leave the rest as it is
    #[arg(long, conflicts_with = "measure")]
    in_doubt: bool,
}

#[derive(Args)]
struct SetupArguments {
    /// Install nothing: where something is missing, say what to type and stop
    #[arg(long)]
    no_install: bool,
}

#[derive(Args)]
struct CheckArguments {
    #[command(flatten)]
    setup: SetupArguments,
    /// Go on after a failed step, and name all that failed at the end
    #[arg(long)]
    keep_going: bool,
}

#[derive(Args)]
struct DemoArguments {
    #[command(flatten)]
    setup: SetupArguments,
    /// Length of the synthetic recording, in frames
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(2..))]
    frames: u32,
    /// Folder for the recording and the result [default: out/demo in the workspace, replaced at each run]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Args)]
struct AccuracyArguments {
    #[command(flatten)]
    setup: SetupArguments,
    /// Folder of real recordings [default: what the environment variable ITM_TEST_DATA names; without it, none]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// The first 60 frames of each recording only; the tables are printed, and docs/ACCURACY.md stays as it is
    #[arg(long)]
    quick: bool,
    /// These recordings only, by their names in the tables; docs/ACCURACY.md stays as it is then
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
}

impl SetupArguments {
    fn installing(&self) -> Installing {
        if self.no_install { Installing::Forbidden } else { Installing::Allowed }
    }
}

fn main() -> ExitCode {
    // Printed here, because anyhow's own form adds a backtrace wherever RUST_BACKTRACE is set, as on many build servers.
    let Err(error) = run() else { return ExitCode::SUCCESS };
    eprintln!("error: {error}");
    for cause in error.chain().skip(1) {
        eprintln!("because {cause}");
    }
    ExitCode::FAILURE
}

fn run() -> Result<()> {
    match Arguments::parse().task {
        Task::Setup(arguments) => setup::adapter(arguments.installing()),
        Task::Test(arguments) => checks::test(arguments.setup.installing(), arguments.keep_going),
        Task::Ci(arguments) => checks::ci(arguments.setup.installing(), arguments.keep_going),
        Task::Python(arguments) => python::test(arguments.installing()),
        Task::Demo(arguments) => demo::demo(arguments.setup.installing(), arguments.frames, arguments.out.as_deref()),
        Task::TrainVerdict(arguments) => {
            verdict::train(arguments.setup.installing(), arguments.measure, arguments.in_doubt)
        }
        Task::Accuracy(AccuracyArguments { setup, data, quick, only }) => {
            accuracy::accuracy(setup.installing(), data.as_deref(), quick, &only)
        }
    }
}

/// The folder of the workspace's `Cargo.toml`.
fn workspace_root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace's folder")
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn a_demo_needs_two_frames() {
        assert!(Arguments::try_parse_from(["xtask", "demo", "--frames", "1"]).is_err());
        let Task::Demo(demo) = Arguments::try_parse_from(["xtask", "demo", "--frames", "2"]).unwrap().task else {
            panic!("parsed as another task");
        };
        assert_eq!(demo.frames, 2);
    }
}
