//! Which files of the folder are ours, and which of them go when there is too much.

use super::Key;
use std::{
    ffi::OsStr,
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

/// What an entry's file ends with.
const ENTRY_END: &str = ".entry";
/// What a file that is being written begins with.
const ASIDE_START: &str = ".osteoflow-";
/// What was written aside and never put in place is left over from a process that was killed: nothing takes an hour.
const LEFT_OVER: Duration = Duration::from_secs(3600);
/// A file takes whole blocks of a disk, and so do many small ones.
const BLOCK_BYTES: u64 = 4096;
/// So many digits a digest has.
const N_DIGITS: usize = 64;

pub(super) fn entry_name(key: &Key) -> String {
    format!("{key}{ENTRY_END}")
}

pub(super) fn aside_name(own: &str, n: u64) -> String {
    format!("{ASIDE_START}{own}-{n}.part")
}

/// What a file of so many bytes takes.
pub(super) fn on_disk(n_bytes: u64) -> u64 {
    n_bytes.div_ceil(BLOCK_BYTES).saturating_mul(BLOCK_BYTES)
}

struct Found {
    used: SystemTime,
    path: PathBuf,
    n_bytes: u64,
}

/// Removes the entries that were not used for longest, as long as there are more than `max_bytes`; answers how many bytes
/// are left. Files that are not ours stay and do not count.
pub(super) fn make_room(dir: &Path, max_bytes: u64) -> io::Result<u64> {
    let now = SystemTime::now();
    let mut entries = Vec::new();
    for file in fs::read_dir(dir)? {
        let file = file?;
        let name = file.file_name();
        let (is_entry, is_aside) = (is_entry(&name), is_aside(&name));
        // Another process may have removed it meanwhile.
        let Some(metadata) = (is_entry || is_aside).then(|| file.metadata().ok()).flatten() else { continue };
        let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        if is_entry {
            entries.push(Found { used, path: file.path(), n_bytes: on_disk(metadata.len()) });
        } else if now.duration_since(used).is_ok_and(|age| age > LEFT_OVER) {
            let _ = fs::remove_file(file.path());
        }
    }
    let mut left: u64 = entries.iter().map(|entry| entry.n_bytes).sum();
    entries.sort_unstable_by(|a, b| (a.used, &a.path).cmp(&(b.used, &b.path)));
    for entry in entries {
        if left <= max_bytes {
            break;
        }
        let removed = fs::remove_file(&entry.path);
        if removed.is_ok() || removed.is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
            left -= entry.n_bytes;
        }
    }
    Ok(left)
}

/// `space-<64 digits>.entry`
fn is_entry(name: &OsStr) -> bool {
    let parts = name.to_str().and_then(|name| name.strip_suffix(ENTRY_END)?.split_once('-'));
    parts.is_some_and(|(_, digits)| digits.len() == N_DIGITS && digits.bytes().all(|b| b.is_ascii_hexdigit()))
}

fn is_aside(name: &OsStr) -> bool {
    name.to_str().is_some_and(|name| name.starts_with(ASIDE_START) && name.ends_with(".part"))
}
