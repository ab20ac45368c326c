//! `test` and `ci`: all that must hold before a change goes in.

use std::process::Command;

use anyhow::Result;

use crate::python;
use crate::setup::{self, Installing, cargo, succeeds};
use crate::steps::{Step, run_all};

/// Sets up what is missing, then formatting, lints, documentation, every test and doc test, and the Python package's tests.
pub(crate) fn test(installing: Installing, keep_going: bool) -> Result<()> {
    setup::components(installing)?;
    setup::adapter(installing)?;
    setup::display(installing)?;
    run_all(steps(installing, keep_going)?, keep_going)
}

/// The same, and cargo-deny before it.
pub(crate) fn ci(installing: Installing, keep_going: bool) -> Result<()> {
    setup::components(installing)?;
    setup::adapter(installing)?;
    setup::display(installing)?;
    let mut steps = steps(installing, keep_going)?;
    if succeeds(cargo().args(["deny", "--version"])) {
        steps.insert(0, Step::new("deny", with_arguments(&["deny", "check", "bans", "licenses", "sources"])));
    } else {
        println!("Licences and duplicates: not checked, for want of cargo-deny (cargo install --locked cargo-deny)");
    }
    run_all(steps, keep_going)
}

/// The cheap steps first, the tests last, so that their result is what stands at the end.
fn steps(installing: Installing, keep_going: bool) -> Result<Vec<Step>> {
    let mut doc = with_arguments(&["doc", "--workspace", "--no-deps"]);
    doc.env("RUSTDOCFLAGS", deny_warnings(std::env::var("RUSTDOCFLAGS").ok().as_deref()));
    let mut test = with_arguments(&["test", "--workspace"]);
    if keep_going {
        test.arg("--no-fail-fast");
    }
    Ok(vec![
        Step::new("fmt", with_arguments(&["fmt", "--all", "--check"])),
        Step::new("clippy", with_arguments(&["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"])),
        Step::new("doc", doc),
        Step::new("test", test),
        python::step(installing)?,
    ])
}

/// The user's flags for rustdoc, and warnings denied.
fn deny_warnings(flags: Option<&str>) -> String {
    let mut flags = flags.unwrap_or_default().to_owned();
    flags.push_str(" -D warnings");
    flags.trim_start().to_owned()
}

fn with_arguments(arguments: &[&str]) -> Command {
    let mut command = cargo();
    command.args(arguments);
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_users_rustdoc_flags_stay() {
        assert_eq!(deny_warnings(None), "-D warnings");
        assert_eq!(deny_warnings(Some("--cfg docsrs")), "--cfg docsrs -D warnings");
    }
}
