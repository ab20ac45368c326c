//! Runs commands one after another, names each and takes its time.

use std::fmt;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail};

/// One command with a short name.
pub(crate) struct Step {
    name: &'static str,
    command: Command,
}

impl Step {
    pub(crate) fn new(name: &'static str, command: Command) -> Self {
        Self { name, command }
    }
}

/// What became of a step, and its wall time.
struct Outcome {
    name: &'static str,
    passed: bool,
    time: Duration,
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.passed { "ok" } else { "FAILED" };
        write!(f, "{:<16} {verdict:<6} {:8.1} s", self.name, self.time.as_secs_f64())
    }
}

/// Runs the steps, their output passed through, up to the first that fails or, where `keep_going`, all of them. Ends
/// with a table; an error where one failed.
pub(crate) fn run_all(steps: Vec<Step>, keep_going: bool) -> Result<()> {
    let mut outcomes = Vec::new();
    for mut step in steps {
        println!("\n== {}: {}", step.name, line(&step.command));
        let start = Instant::now();
        let status = step.command.status().with_context(|| format!("can't run {}", line(&step.command)))?;
        outcomes.push(Outcome { name: step.name, passed: status.success(), time: start.elapsed() });
        if !status.success() && !keep_going {
            break;
        }
    }
    println!();
    for outcome in &outcomes {
        println!("{outcome}");
    }
    let failed: Vec<_> = outcomes.iter().filter(|outcome| !outcome.passed).map(|outcome| outcome.name).collect();
    if !failed.is_empty() {
        bail!("failed: {}", failed.join(", "));
    }
    Ok(())
}

/// Runs one command, its output passed through, and returns its wall time; an error where it fails.
pub(crate) fn run(command: &mut Command) -> Result<Duration> {
    let start = Instant::now();
    let status = command.status().with_context(|| format!("can't run {}", line(command)))?;
    if !status.success() {
        bail!("{} failed, {status}", line(command));
    }
    Ok(start.elapsed())
}

/// The command as one would type it, without the folder of its program.
pub(crate) fn line(command: &Command) -> String {
    let program = std::path::Path::new(command.get_program()).file_stem().unwrap_or_default();
    let words = std::iter::once(program).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
#[cfg(unix)] // for `true`, `false` and `touch`
mod tests {
    use super::*;

    fn step(name: &'static str, program: &str) -> Step {
        Step::new(name, Command::new(program))
    }

    #[test]
    fn the_first_failure_ends_the_run() {
        let folder = tempfile::tempdir().unwrap();
        let trace = folder.path().join("trace");
        let steps = |trace: &std::path::Path| {
            let mut touch = Command::new("touch");
            touch.arg(trace);
            vec![step("first", "true"), step("second", "false"), Step::new("third", touch)]
        };
        let error = run_all(steps(&trace), false).unwrap_err();
        assert_eq!(error.to_string(), "failed: second");
        assert!(!trace.exists());
        let error = run_all(steps(&trace), true).unwrap_err();
        assert_eq!(error.to_string(), "failed: second");
        assert!(trace.exists());
    }

    #[test]
    fn every_failure_is_named() {
        let error = run_all(vec![step("a", "false"), step("b", "true"), step("c", "false")], true).unwrap_err();
        assert_eq!(error.to_string(), "failed: a, c");
        assert!(run_all(vec![step("a", "true"), step("b", "true")], false).is_ok());
    }

    #[test]
    fn a_command_reads_as_typed() {
        let mut command = Command::new("some/folder/cargo");
        command.args(["test", "--workspace"]);
        assert_eq!(line(&command), "cargo test --workspace");
    }
}
