//! Files that are looked at again and again.
//!
//! They are asked for their stamps, twenty times a second, and no notice of the system is waited for. A graph names a
//! dozen files, whose stamps cost some microseconds; this works on every file system, also where another machine writes,
//! and with editors that put a new file in the place of the old one.

use crate::{
    hash::{file_stamp::stamp, files::list},
    plan::Plan,
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

/// How often files are looked at.
const LOOK: Duration = Duration::from_millis(50);

/// Files and folders as they were at a time: of each its size, its times and which file it is; of a folder, those of all
/// files in it. One that is not there has its place too.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stamps(BTreeMap<PathBuf, String>);

impl Stamps {
    /// As they are now.
    pub fn of(paths: impl IntoIterator<Item = PathBuf>) -> Self {
        let told = |path: PathBuf| {
            let stamp = of_path(&path);
            (path, stamp)
        };
        Self(paths.into_iter().map(told).collect())
    }

    /// Of all that a plan reads beside its text.
    pub fn of_plan(plan: &Plan) -> Self {
        Self::of(plan.input_files.iter().cloned())
    }

    /// These, and others.
    #[must_use]
    pub fn and(mut self, others: &Self) -> Self {
        self.0.extend(others.0.clone());
        self
    }

    /// What was seen of a file; `None` if it was not looked at.
    pub(crate) fn get(&self, path: &Path) -> Option<&str> {
        self.0.get(path).map(String::as_str)
    }

    /// Whether both have seen the file alike.
    pub(super) fn agree(&self, other: &Self, path: &Path) -> bool {
        self.0.get(path) == other.0.get(path)
    }

    /// Waits until one of the files has changed and all have come to rest: two looks in a row find the same, so that a
    /// file half written is not taken for the new one. Answers when the change was seen; `None` if it is cancelled.
    pub fn wait(&self, cancelled: &AtomicBool) -> Option<Instant> {
        let look = || {
            thread::sleep(LOOK);
            (!cancelled.load(Ordering::Relaxed)).then(|| Self::of(self.0.keys().cloned()))
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
    let told = |file: &PathBuf| match file.metadata() {
        Ok(metadata) => format!("{}: {}\n", file.display(), stamp(&metadata)),
        Err(_) => format!("{}: not there\n", file.display()),
    };
    files.iter().map(told).collect()
}
