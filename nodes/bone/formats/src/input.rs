//! Opens files for reading: every reader of this crate does so here.
//!
//! A pipe or a socket would be waited for, and a device may never end, so what is not a regular file is refused before it is
//! opened.

use crate::{FileError, kind::marked};
use osteoflow_container::irregular;
use serde::de::DeserializeOwned;
use sha2::{Digest as _, Sha256};
use std::{
    fs::{self, File},
    io::Read as _,
    path::Path,
};

/// Checks that the path leads to a regular file.
///
/// # Errors
/// [`FileError::Io`] if it is missing, [`FileError::Kind`] if it is a folder, device, pipe or socket.
pub fn check(path: &Path) -> Result<(), FileError> {
    if fs::metadata(path).map_err(FileError::read(path))?.is_file() {
        return Ok(());
    }
    Err(FileError::Kind { path: path.into(), kind: irregular(path).unwrap_or("a folder") })
}

/// Opens a regular file.
///
/// # Errors
/// As [`check`], or if it may not be read.
pub fn open(path: &Path) -> Result<File, FileError> {
    check(path)?;
    File::open(path).map_err(FileError::read(path))
}

/// The bytes of a regular file.
///
/// # Errors
/// As [`open`].
pub fn read(path: &Path) -> Result<Vec<u8>, FileError> {
    check(path)?;
    fs::read(path).map_err(FileError::read(path))
}

/// The first bytes of a regular file, at most `n`.
pub(crate) fn head(path: &Path, n: u64) -> Result<Vec<u8>, FileError> {
    let mut head = Vec::new();
    open(path)?.take(n).read_to_end(&mut head).map_err(FileError::read(path))?;
    Ok(head)
}

/// The text of a regular file.
///
/// # Errors
/// As [`open`], or [`FileError::Content`] with the first byte that is not UTF-8.
pub fn read_text(path: &Path) -> Result<String, FileError> {
    text_of(path, read(path)?)
}

/// The text in the bytes of a file.
pub(crate) fn text_of(path: &Path, bytes: Vec<u8>) -> Result<String, FileError> {
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        match marked(path, error.as_bytes()) {
            Some(found) => found.refusal(path, "a text"),
            None => FileError::content(path, format!("byte {at}"), "the file is no text in UTF-8; save it as UTF-8"),
        }
    })
}

/// A TOML file as what it describes: `what` in errors.
///
/// # Errors
/// As [`read_text`], or [`FileError::Content`] with the line and what is wrong there.
pub fn read_toml<T: DeserializeOwned>(path: &Path, what: &str) -> Result<T, FileError> {
    let text = read_text(path)?;
    toml::from_str(&text).map_err(|error| {
        let line = error.span().map_or(1, |span| text[..span.start].matches('\n').count() + 1);
        FileError::content(path, format!("line {line}"), format!("no {what}: {}", error.message()))
    })
}

/// SHA-256 of a regular file, 64 hexadecimal digits.
///
/// # Errors
/// As [`open`].
pub fn sha256(path: &Path) -> Result<String, FileError> {
    let (mut file, mut hasher, mut buffer) = (open(path)?, Sha256::new(), vec![0; 1 << 16]);
    loop {
        let n = file.read(&mut buffer).map_err(FileError::read(path))?;
        if n == 0 {
            return Ok(hexadecimal(&hasher.finalize()));
        }
        hasher.update(&buffer[..n]);
    }
}

/// SHA-256 of bytes, 64 hexadecimal digits.
pub fn sha256_of(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

fn hexadecimal(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
