//! The folder a run leaves its files in: never one that holds something already, unless told so.

use super::UsageError;
use anyhow::{Context, Result};
use std::{
    fs, io,
    path::{Path, PathBuf},
    time::{SystemTime, UNIX_EPOCH},
};

/// Exactly, beside a picture for viewers, what went over the recorded wires.
pub(crate) const RECORDING: &str = "run.mcap";
/// What the graph's `[results]` names, or why there is none.
pub(crate) const RESULTS: &str = "results.json";
/// How the results came about: graph, versions, hashes, machine, times, counts.
pub(crate) const MANIFEST: &str = "manifest.json";

/// A folder with a repro bundle for each failure.
pub(crate) const REPRO: &str = "repro";

/// Makes the folder: `asked` where given, else a new one under `runs/` in the current folder.
///
/// # Errors
/// If `asked` is a file, or a folder with something in it and `force` is not set. With `force` the files of an earlier
/// run are removed first, so that none can be taken for this one's, and everything else stays.
pub(crate) fn make(asked: Option<&Path>, graph: &str, force: bool) -> Result<PathBuf> {
    let Some(dir) = asked else { return make_new(Path::new("runs"), graph, SystemTime::now()) };
    fs::create_dir_all(dir).with_context(|| format!("{} cannot be made a folder", dir.display()))?;
    let used = fs::read_dir(dir).with_context(|| format!("{} cannot be read", dir.display()))?.next().is_some();
    if used && !force {
        let said =
            format!("{} is not empty; name another folder, or replace the run in it with --force", dir.display());
        return Err(UsageError(said).into());
    }
    for name in [RECORDING, RESULTS, MANIFEST] {
        match fs::remove_file(dir.join(name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("{} cannot be replaced", dir.join(name).display()));
            }
            _ => {}
        }
    }
    remove_bundles(&dir.join(REPRO)).with_context(|| format!("{} cannot be replaced", dir.join(REPRO).display()))?;
    Ok(dir.to_owned())
}

/// Removes the bundles of an earlier run; whatever else lies beside them stays, and then the folder does too.
fn remove_bundles(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    for entry in entries {
        let path = entry?.path();
        let unfinished = path.extension().is_some_and(|end| end == "part") && path.is_dir();
        if unfinished || path.join("repro.json").is_file() {
            fs::remove_dir_all(path)?;
        }
    }
    let _ = fs::remove_dir(folder);
    Ok(())
}

/// A new folder `<graph>-<time>`, with `-2`, `-3` ... where two runs begin in one second.
fn make_new(parent: &Path, graph: &str, now: SystemTime) -> Result<PathBuf> {
    fs::create_dir_all(parent).with_context(|| format!("{} cannot be made a folder", parent.display()))?;
    // A graph may have any name; a folder's has no separators in it.
    let plain = |c: char| if c.is_alphanumeric() || "-_".contains(c) { c } else { '_' };
    let stem = format!("{}-{}", graph.chars().map(plain).collect::<String>(), stamp_text(now));
    make_numbered(parent, &stem, 1)
}

/// The folder for a run after the one that left its files in `dir`: beside it, `dir-2`, `dir-3` and so on.
///
/// # Errors
/// If it cannot be made, or `dir` is the root, which has nothing beside it.
pub(crate) fn make_after(dir: &Path) -> Result<PathBuf> {
    // A name such as `.` has no end to put a number to.
    let dir = match dir.file_name() {
        Some(_) => dir.to_owned(),
        None => std::path::absolute(dir).with_context(|| format!("{} is no folder", dir.display()))?,
    };
    let (Some(parent), Some(name)) = (dir.parent(), dir.file_name()) else {
        return Err(UsageError(format!("{} has nothing beside it; name another folder", dir.display())).into());
    };
    make_numbered(parent, &name.to_string_lossy(), 2)
}

/// The first folder of this name and a number that is not there yet; the first of all has no number.
fn make_numbered(parent: &Path, stem: &str, first: u32) -> Result<PathBuf> {
    for n in first.. {
        let dir = parent.join(if n == 1 { stem.to_owned() } else { format!("{stem}-{n}") });
        match fs::create_dir(&dir) {
            Ok(()) => return Ok(dir),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).with_context(|| format!("{} cannot be made", dir.display())),
        }
    }
    unreachable!("the numbers do not end")
}

/// `20260314-092653`, in UTC.
fn stamp_text(time: SystemTime) -> String {
    let (year, month, day, seconds) = utc(time);
    format!("{year:04}{month:02}{day:02}-{:02}{:02}{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

/// Year, month, day and second of the day, in UTC and the Gregorian calendar.
fn utc(time: SystemTime) -> (u64, u64, u64, u64) {
    let seconds = time.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    // Years begin in March here, so that the leap day is the last of its year; 719468 days lie before 1970 in this count.
    let days = seconds / 86_400 + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day, seconds % 86_400)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_time_is_told_in_the_gregorian_calendar() {
        let told = |seconds| stamp_text(UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(told(0), "19700101-000000");
        assert_eq!(told(951_782_399), "20000228-235959");
        assert_eq!(told(951_782_400), "20000229-000000");
        assert_eq!(told(1_773_480_413), "20260314-092653");
        assert_eq!(told(4_107_542_400), "21000301-000000");
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
    fn a_later_run_gets_the_next_folder_beside_the_first() {
        let parent = tempfile::tempdir().unwrap();
        fs::create_dir(parent.path().join("out-3")).unwrap();
        let made: Vec<_> = (0..2).map(|_| make_after(&parent.path().join("out")).unwrap()).collect();
        assert_eq!(made, [parent.path().join("out-2"), parent.path().join("out-4")]);
        assert!(make_after(Path::new("/")).is_err());
    }

    #[test]
    fn the_name_of_a_graph_leads_nowhere_else() {
        let parent = tempfile::tempdir().unwrap();
        let made = make_new(parent.path(), "../a b", UNIX_EPOCH).unwrap();
        assert_eq!(made, parent.path().join("___a_b-19700101-000000"));
    }

    #[test]
    fn a_folder_in_use_is_refused_and_force_replaces_only_what_a_run_writes() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("notes.txt"), "mine").unwrap();
        fs::write(dir.path().join(RESULTS), "old").unwrap();
        let refused = make(Some(dir.path()), "fibula", false).unwrap_err().to_string();
        assert!(refused.contains("--force"), "{refused}");
        make(Some(dir.path()), "fibula", true).unwrap();
        assert!(dir.path().join("notes.txt").exists());
        assert!(!dir.path().join(RESULTS).exists());
    }
}
