//! Detects changes of files by polling.
//!
//! Stamps are polled twenty times a second, without notifications of the operating system. A graph names about a dozen
//! files, whose stamps take some microseconds; this works on every file system, also for changes from other machines
//! and for editors that replace a file by a new one.

use crate::{
    hash::{file_stamp::stamp, files::list},
    plan::Plan,
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

/// Polling interval.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// State of files and folders at one time: size, times and identity of each; for a folder, those of all files in it.
/// Missing files are included.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stamps(BTreeMap<PathBuf, String>);

impl Stamps {
    /// The current state of these paths.
    pub fn of(paths: impl IntoIterator<Item = PathBuf>) -> Self {
        let stamped = |path: PathBuf| {
            let stamp = of_path(&path);
            (path, stamp)
        };
        Self(paths.into_iter().map(stamped).collect())
    }

    /// The current state of all files that a plan reads, apart from its text.
    pub fn of_plan(plan: &Plan) -> Self {
        Self::of(plan.input_files.iter().cloned())
    }

    /// Adds the stamps of `others`.
    #[must_use]
    pub fn and(mut self, others: &Self) -> Self {
        self.0.extend(others.0.clone());
        self
    }

    /// The first path whose state is another now.
    pub(crate) fn changed(&self) -> Option<&Path> {
        self.0.iter().find(|(path, stamp)| of_path(path) != **stamp).map(|(path, _)| path.as_path())
    }

    /// Stamp of a file; `None` if it is not included.
    pub(crate) fn get(&self, path: &Path) -> Option<&str> {
        self.0.get(path).map(String::as_str)
    }

    /// Whether both have the same stamp of the file.
    pub(super) fn agree(&self, other: &Self, path: &Path) -> bool {
        self.0.get(path) == other.0.get(path)
    }

    /// Waits until a file has changed and all files are stable: two consecutive polls agree, so that a half-written
    /// file is not taken for the new one. Returns when the change was seen; `None` once `stops` says so.
    pub fn wait(&self, stops: &dyn Fn() -> bool) -> Option<Instant> {
        let look = || {
            thread::sleep(POLL_INTERVAL);
            (!stops()).then(|| Self::of(self.0.keys().cloned()))
        };
        let mut now = look()?;
        while now == *self {
            now = look()?;
        }
        let seen = Instant::now();
        loop {
            let next = look()?;
            if next == now {
                return Some(seen);
            }
            now = next;
        }
    }
}

fn of_path(path: &Path) -> String {
    let mut files = Vec::new();
    if list(path, &mut files).is_err() {
        return "cannot be read".into();
    }
    let describe = |file: &PathBuf| match file.metadata() {
        Ok(metadata) => format!("{}: {}\n", file.display(), stamp(&metadata)),
        Err(_) => format!("{}: not there\n", file.display()),
    };
    files.iter().map(describe).collect()
}
