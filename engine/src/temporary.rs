//! Folders among the system's temporary files, which no killed process leaves for long.

use crate::durable;
use std::io;
use tempfile::TempDir;

/// A new folder, which is removed on drop. Only its owner may use it.
///
/// # Errors
/// If it cannot be created.
pub fn folder(prefix: &str) -> io::Result<TempDir> {
    durable::remove_leftovers(&std::env::temp_dir(), "osteoflow-");
    tempfile::Builder::new().prefix(&format!("osteoflow-{prefix}-")).suffix(&durable::suffix()).tempdir()
}
