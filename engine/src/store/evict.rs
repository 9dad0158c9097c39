//! File names of the store, and eviction of the least recently used entries.

use super::Key;
use std::{
    ffi::OsStr,
    fs, io,
    path::{Path, PathBuf},
    time::SystemTime,
};

/// Suffix of an entry's file.
const ENTRY_SUFFIX: &str = ".entry";
/// Files occupy whole disk blocks.
const BLOCK_BYTES: u64 = 4096;
/// Number of hexadecimal digits of a digest.
const N_DIGITS: usize = 64;

pub(super) fn entry_name(key: &Key) -> String {
    format!("{key}{ENTRY_SUFFIX}")
}

/// Disk space of a file with `n_bytes`.
pub(super) fn on_disk(n_bytes: u64) -> u64 {
    n_bytes.div_ceil(BLOCK_BYTES).saturating_mul(BLOCK_BYTES)
}

struct StoredFile {
    used: SystemTime,
    path: PathBuf,
    n_bytes: u64,
}

/// Removes the least recently used entries until at most `max_bytes` are left, and returns the bytes that are left.
/// Other files are neither counted nor removed.
pub(super) fn make_room(dir: &Path, max_bytes: u64) -> io::Result<u64> {
    let mut entries = Vec::new();
    for file in fs::read_dir(dir)? {
        let file = file?;
        // Another process may have removed it in the meantime.
        let Some(metadata) = is_entry(&file.file_name()).then(|| file.metadata().ok()).flatten() else { continue };
        let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        entries.push(StoredFile { used, path: file.path(), n_bytes: on_disk(metadata.len()) });
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
    let parts = name.to_str().and_then(|name| name.strip_suffix(ENTRY_SUFFIX)?.split_once('-'));
    parts.is_some_and(|(_, digits)| digits.len() == N_DIGITS && digits.bytes().all(|b| b.is_ascii_hexdigit()))
}
