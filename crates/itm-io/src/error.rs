//! What can go wrong with a file.

use std::path::PathBuf;

use thiserror::Error;

/// Why a file could not be read or written: what was expected, what was found, and where.
#[derive(Debug, Error)]
pub enum Error {
    /// The operating system refused to open, read, list or write something.
    #[error("cannot {action} '{}': {source}", path.display())]
    Io {
        /// What was tried: `open`, `read`, `list`, `write`.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A line of a text file that is not of its format.
    #[error("'{}', line {line}: expected {expected}, found {found}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What would do.
        expected: String,
        /// What stands there.
        found: String,
    },
}
