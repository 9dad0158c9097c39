//! The file with the code of this program.

use super::{Digest, files::sha256};
use std::{env, path::PathBuf, sync::OnceLock};

static FILE: OnceLock<PathBuf> = OnceLock::new();

/// Names the library with this code, in a process whose executable is another program, such as an interpreter. Only the first
/// call counts.
pub fn set_file(library: PathBuf) {
    let _ = FILE.set(library);
}

/// SHA-256 of the library of [`set_file`], otherwise of the executable, as the file was when it was first asked for; `None` if it
/// cannot be read.
pub(crate) fn digest() -> Option<Digest> {
    static DIGEST: OnceLock<Option<Digest>> = OnceLock::new();
    *DIGEST.get_or_init(|| {
        let file = FILE.get().map_or_else(env::current_exe, |file| Ok(file.clone()));
        file.and_then(|file| sha256(&file)).ok().map(|(_, digest)| digest)
    })
}
