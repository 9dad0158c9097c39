//! File stamps, which detect a changed file without reading it.

use std::{fs::Metadata, time::SystemTime};

/// Size and times of a file, and its inode if the system has one: a replaced file has another stamp.
pub(crate) fn stamp(file: &Metadata) -> String {
    let modified = file.modified().ok().and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
    let stamp = format!("{} bytes, {modified:?}", file.len());
    #[cfg(unix)]
    let stamp = {
        use std::os::unix::fs::MetadataExt;
        format!("{stamp}, {}.{:09}, {}:{}", file.ctime(), file.ctime_nsec(), file.dev(), file.ino())
    };
    stamp
}
