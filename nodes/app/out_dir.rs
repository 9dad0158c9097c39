//! The folder that a run writes its files into: new or empty, except with `--force`, and of this process alone.

use super::{
    error::UsageError,
    folder_lock::{FolderLock, HOLDER},
};
use anyhow::{Context, Result};
use jiff::Timestamp;
use osteoflow_engine::run::files;
use std::{
    fs, io,
    ops::Deref,
    path::{Path, PathBuf},
    time::SystemTime,
};

/// The folder for runs that name none, in the current folder.
const RUNS: &str = "runs";

/// A folder for the files of a run, locked until it is dropped.
#[derive(Debug)]
pub(crate) struct OutDir {
    path: PathBuf,
    _lock: FolderLock,
}

impl OutDir {
    /// Removes the folder of a run that has written nothing.
    pub(crate) fn remove_if_empty(self) {
        let path = self.path.clone();
        drop(self);
        let _ = fs::remove_dir(path);
    }
}

impl Deref for OutDir {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.path
    }
}

/// Creates a folder for other files than those of a run. One that is not empty is refused unless `force` is set, with the remedy in
/// the message.
pub(crate) fn make_plain(dir: &Path, force: bool, remedy: &str) -> Result<()> {
    make_folder(dir)?;
    if force { Ok(()) } else { check_empty(dir, remedy) }
}

/// Refuses a folder that is not empty, with the remedy in the message, and a file.
pub(crate) fn check_empty(dir: &Path, remedy: &str) -> Result<()> {
    check_no_file(dir)?;
    if !dir.exists() {
        return Ok(());
    }
    let mut entries = fs::read_dir(dir).with_context(|| format!("{} cannot be read", dir.display()))?;
    if entries.any(|entry| entry.is_ok_and(|entry| entry.file_name() != HOLDER)) {
        usage!("{} is not empty; {remedy}", dir.display());
    }
    Ok(())
}

fn check_no_file(dir: &Path) -> Result<()> {
    match dir.ancestors().find(|above| above.is_file()) {
        Some(file) => Err(UsageError(format!("{} is a file; name a folder", file.display())).into()),
        None => Ok(()),
    }
}

fn make_folder(dir: &Path) -> Result<()> {
    check_no_file(dir)?;
    fs::create_dir_all(dir).with_context(|| format!("{} cannot be made a folder", dir.display()))
}

/// Creates the folder: `out` if given, otherwise a new one under `runs/` in the current folder.
///
/// # Errors
/// If `out` is a file, a folder that another process writes into, or a folder that is not empty and `force` is not set. With
/// `force`, the files of an earlier run are removed and everything else stays.
pub(crate) fn make(out: Option<&Path>, graph: &str, force: bool) -> Result<OutDir> {
    let Some(dir) = out else { return make_new(Path::new(RUNS), graph, SystemTime::now()) };
    make_folder(dir)?;
    let lock = FolderLock::take(dir)?;
    make_plain(dir, force, "name another folder, or replace the run in it with --force")?;
    for name in [files::RECORDING, files::RESULTS, files::MANIFEST] {
        match fs::remove_file(dir.join(name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("{} cannot be replaced", dir.join(name).display()));
            }
            _ => {}
        }
    }
    remove_bundles(&dir.join(files::REPRO))
        .with_context(|| format!("{} cannot be replaced", dir.join(files::REPRO).display()))?;
    Ok(OutDir { path: dir.to_owned(), _lock: lock })
}

/// Removes the bundles of an earlier run, and then the folder if nothing else is in it.
fn remove_bundles(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let path = entry?.path();
        let unfinished = path.extension().is_some_and(|end| end == "part") && path.is_dir();
        if unfinished || path.join(files::REPRO_BUNDLE).is_file() {
            fs::remove_dir_all(path)?;
        }
    }
    let _ = fs::remove_dir(folder);
    Ok(())
}

/// Creates a new folder `<graph>-<time>`; `-2`, `-3` ... is appended if several runs begin in the same second.
fn make_new(parent: &Path, graph: &str, now: SystemTime) -> Result<OutDir> {
    make_folder(parent)?;
    // A graph may have any name; that of a folder must not contain separators.
    let plain = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '_' };
    let stem = format!("{}-{}", graph.chars().map(plain).collect::<String>(), time_in_name(now));
    make_numbered(parent, &stem, 1)
}

/// Creates the folder for a run after the one in `dir`, beside it: `dir-2`, `dir-3` and so on.
///
/// # Errors
/// If it cannot be made, or `dir` is the root, which has nothing beside it.
pub(crate) fn make_after(dir: &Path) -> Result<OutDir> {
    // A path such as `.` has no name to append a number to.
    let dir = match dir.file_name() {
        Some(_) => dir.to_owned(),
        None => std::path::absolute(dir).with_context(|| format!("{} is not a folder", dir.display()))?,
    };
    let (Some(parent), Some(name)) = (dir.parent(), dir.file_name()) else {
        usage!("{} has no parent folder; name another folder", dir.display());
    };
    make_numbered(parent, &name.to_string_lossy(), 2)
}

/// Creates the first folder of this name and a number that does not exist yet; number 1 is left out.
fn make_numbered(parent: &Path, stem: &str, first: u32) -> Result<OutDir> {
    for n in first.. {
        let dir = parent.join(if n == 1 { stem.to_owned() } else { format!("{stem}-{n}") });
        match fs::create_dir(&dir) {
            Ok(()) => {
                let _lock = FolderLock::take(&dir)?;
                return Ok(OutDir { path: dir, _lock });
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).with_context(|| format!("{} cannot be made", dir.display())),
        }
    }
    unreachable!("the numbers do not end")
}

/// Formats a time as `20260314-092653`, in UTC.
fn time_in_name(time: SystemTime) -> String {
    Timestamp::try_from(time).unwrap_or(Timestamp::UNIX_EPOCH).strftime("%Y%m%d-%H%M%S").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, UNIX_EPOCH};

    #[test]
    fn times_are_formatted_in_utc() {
        let formatted = |seconds| time_in_name(UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(formatted(0), "19700101-000000");
        assert_eq!(formatted(951_782_399), "20000228-235959");
        assert_eq!(formatted(951_782_400), "20000229-000000");
        assert_eq!(formatted(1_773_480_413), "20260314-092653");
        assert_eq!(formatted(4_107_542_400), "21000301-000000");
    }

    #[test]
    fn two_runs_in_one_second_get_folders_of_their_own() {
        let parent = tempfile::tempdir().unwrap();
        let now = UNIX_EPOCH + Duration::from_secs(1_773_480_413);
        let made: Vec<_> = (0..3).map(|_| make_new(parent.path(), "fibula", now).unwrap()).collect();
        let names: Vec<_> = made.iter().map(|d| d.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(names, ["fibula-20260314-092653", "fibula-20260314-092653-2", "fibula-20260314-092653-3"]);
    }

    #[test]
    fn a_later_run_gets_the_next_free_number() {
        let parent = tempfile::tempdir().unwrap();
        fs::create_dir(parent.path().join("out-3")).unwrap();
        let made: Vec<_> = (0..2).map(|_| make_after(&parent.path().join("out")).unwrap()).collect();
        let made: Vec<&Path> = made.iter().map(|dir| &**dir).collect();
        assert_eq!(made, [parent.path().join("out-2"), parent.path().join("out-4")]);
        assert!(make_after(Path::new("/")).is_err());
    }

    #[test]
    fn the_name_of_a_graph_cannot_leave_the_folder() {
        let parent = tempfile::tempdir().unwrap();
        let made = make_new(parent.path(), "../a b", UNIX_EPOCH).unwrap();
        assert_eq!(*made, parent.path().join("___a_b-19700101-000000"));
    }

    #[test]
    fn a_folder_in_use_is_refused_and_force_replaces_only_what_a_run_writes() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("notes.txt"), "mine").unwrap();
        fs::write(dir.path().join(files::RESULTS), "old").unwrap();
        let refused = make(Some(dir.path()), "fibula", false).unwrap_err().to_string();
        assert!(refused.contains("--force"), "{refused}");
        make(Some(dir.path()), "fibula", true).unwrap();
        assert!(dir.path().join("notes.txt").exists());
        assert!(!dir.path().join(files::RESULTS).exists());
    }
}
