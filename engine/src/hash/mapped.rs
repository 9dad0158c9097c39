//! The libraries that a process has mapped.

use std::{collections::BTreeSet, path::PathBuf};

/// The files mapped as code; on Linux only.
pub(crate) fn mapped() -> BTreeSet<PathBuf> {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    maps.lines()
        // address perms offset dev inode path
        .filter(|line| line.split_whitespace().nth(1).is_some_and(|flags| flags.contains('x')))
        // A file that has been deleted is still mapped under its old path.
        .filter_map(|line| line.find('/').map(|at| PathBuf::from(line[at..].trim_end_matches(" (deleted)"))))
        .collect()
}
