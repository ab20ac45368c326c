//! Small data that itm's crates ship, as constants, so that it travels with them.

/// The classifier of tracking's verdicts, which `cargo xtask train-verdict` writes.
pub const VERDICT: &str = include_str!("../verdict.toml");
