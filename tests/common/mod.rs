//! What the tests of the command share.
#![allow(dead_code, reason = "each test file is a crate of its own and uses its part")]

use assert_cmd::Command;
use std::path::{Path, PathBuf};

/// The command under test, in the workspace's folder, without the settings of whoever runs the tests.
pub(crate) fn osteoflow() -> Command {
    let mut command = Command::cargo_bin("osteoflow").unwrap();
    command.current_dir(root()).env_remove("OSTEOFLOW_LOG").env("NO_COLOR", "1");
    command
}

/// The workspace's folder.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Development data that is not part of the repository; says so and gives nothing where it is absent.
pub(crate) fn data(test: &str, path: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("OSTEOFLOW_DATA").map_or_else(|| root().join("../shared/data"), PathBuf::from);
    let path = folder.join(path);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {test}: no development data");
    None
}

/// Holds generated text equal to a file of the repository; `UPDATE=1` rewrites the file.
pub(crate) fn assert_golden(path: &Path, text: &str) {
    if std::env::var_os("UPDATE").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
        return;
    }
    let golden = std::fs::read_to_string(path).unwrap_or_default();
    let line = golden.lines().zip(text.lines()).position(|(a, b)| a != b).map_or(0, |at| at + 1);
    assert!(
        golden == text,
        "{} differs first at line {line} (0: only in length); `UPDATE=1 cargo test --release` rewrites it, then read the \
         diff\n--- now\n{text}",
        path.display()
    );
}
