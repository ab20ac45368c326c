//! Rules of the workspace that no compiler checks: which crate may depend on which, and what files must look like.
//!
//! Each rule is a function from what was found to a list of violations, so that a small test beside it can show that it
//! catches what it is for.
#![allow(clippy::unwrap_used, reason = "clippy's exemption for tests does not reach the functions that they share")]

mod dependencies;
mod manifests;
mod tidy;

use std::path::Path;

/// The folder of the workspace's `Cargo.toml`.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace's folder")
}

/// Fails with all violations of a rule, one a line.
#[track_caller]
fn assert_none(rule: &str, violations: &[String]) {
    assert!(violations.is_empty(), "{rule}:\n  {}", violations.join("\n  "));
}
