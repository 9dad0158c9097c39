//! The file with the code of this program.

use super::{Digest, file_stamp::stamp, files::sha256};
use std::{
    env, io,
    path::{Path, PathBuf},
    sync::OnceLock,
};

/// The library, and its stamp when it was named.
static LIBRARY: OnceLock<(PathBuf, Option<String>)> = OnceLock::new();

/// Names the library with this code, in a process whose executable is another program, such as an interpreter. Only the first
/// call counts.
pub fn set_file(library: PathBuf) {
    let named = stamp_of(&library).ok();
    let _ = LIBRARY.set((library, named));
}

/// The library of [`set_file`], otherwise the executable.
///
/// # Errors
/// If the executable's path is unknown.
pub fn file() -> io::Result<PathBuf> {
    LIBRARY.get().map_or_else(env::current_exe, |(library, _)| Ok(library.clone()))
}

/// Where the code that runs can be read: of an executable also if the file at its path was replaced, on Linux.
///
/// # Errors
/// If the path is unknown, or the library was replaced after it was loaded.
pub(crate) fn readable() -> io::Result<PathBuf> {
    match LIBRARY.get() {
        Some((library, named)) if stamp_of(library).ok() != *named => {
            Err(io::Error::other(format!("{} was replaced after it was loaded", library.display())))
        }
        None if cfg!(target_os = "linux") => Ok("/proc/self/exe".into()),
        _ => file(),
    }
}

fn stamp_of(file: &Path) -> io::Result<String> {
    Ok(stamp(&file.metadata()?))
}

/// SHA-256 of [`readable`], as the file was when it was first asked for; `None` if it cannot be read.
pub(crate) fn digest() -> Option<Digest> {
    static DIGEST: OnceLock<Option<Digest>> = OnceLock::new();
    *DIGEST.get_or_init(|| sha256(&readable().ok()?).ok().map(|(_, digest)| digest))
}
