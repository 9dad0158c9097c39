//! What tells a changed file from the one before, without reading it.

use std::{fs::Metadata, time::SystemTime};

/// Size and times of a file, and where the system tells it, which file it is: a new one has another stamp.
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
