//! SHA-256 of files and of the files in folders.

use super::Digest;
use crate::regular;
use serde_json::{Value as Json, json};
use sha2::{Digest as _, Sha256};
use std::{
    collections::BTreeSet,
    io::{self, Read, Write},
    path::{Path, PathBuf},
    thread::{self, JoinHandle},
};

/// File hashes computed on a background thread.
pub(crate) struct Hashes {
    files: Vec<PathBuf>,
    thread: Option<JoinHandle<Vec<Json>>>,
    done: Vec<Json>,
}

impl Hashes {
    pub(crate) fn begin(files: &[PathBuf]) -> Self {
        let (files, all) = (files.to_vec(), files.to_vec());
        Self { files: all, thread: Some(thread::spawn(move || hashes(&files))), done: Vec::new() }
    }

    /// Waits for all hashes.
    pub(crate) fn done(&mut self) -> &[Json] {
        if let Some(thread) = self.thread.take() {
            let failed = |path: &PathBuf| error(path, "the thread that hashes it panicked");
            self.done = thread.join().unwrap_or_else(|_| self.files.iter().map(failed).collect());
        }
        &self.done
    }
}

/// Path, size and SHA-256 of each input file, once; a folder is replaced by its files, sorted by name.
pub(crate) fn hashes(paths: &[PathBuf]) -> Vec<Json> {
    let (mut out, mut known) = (Vec::new(), BTreeSet::new());
    for path in paths {
        let mut files = Vec::new();
        match list(path, &mut files) {
            Ok(()) => {
                files.retain(|file| known.insert(file.clone()));
                out.extend(files.iter().map(|file| entry(file)));
            }
            Err(cause) => out.push(error(path, &cause.to_string())),
        }
    }
    out
}

fn error(path: &Path, message: &str) -> Json {
    json!({ "path": path.display().to_string(), "error": message })
}

/// Lists the file, or all files in the folder and its subfolders, sorted by name.
pub(crate) fn list(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if !path.is_dir() {
        files.push(path.into());
        return Ok(());
    }
    let mut entries = std::fs::read_dir(path)?.map(|e| e.map(|e| e.path())).collect::<io::Result<Vec<_>>>()?;
    entries.sort();
    // A link to a parent folder would never end.
    entries.retain(|path| !(path.is_symlink() && path.is_dir()));
    entries.iter().try_for_each(|path| list(path, files))
}

fn entry(path: &Path) -> Json {
    match sha256(path) {
        Ok((bytes, hash)) => json!({ "path": path.display().to_string(), "bytes": bytes, "sha256": hash.to_string() }),
        Err(cause) => error(path, &cause.to_string()),
    }
}

/// Size and SHA-256 of a file.
///
/// # Errors
/// If it cannot be read, or is no regular file.
pub fn sha256(path: &Path) -> io::Result<(u64, Digest)> {
    copy_hashed(regular(path).and_then(std::fs::File::open)?, &mut io::sink())
}

/// Copies what is read; its size and SHA-256.
///
/// # Errors
/// If it cannot be read or written.
pub fn copy_hashed(mut from: impl Read, to: &mut dyn Write) -> io::Result<(u64, Digest)> {
    let (mut hasher, mut bytes, mut buffer) = (Sha256::new(), 0, vec![0; 1 << 16]);
    loop {
        let n = from.read(&mut buffer)?;
        if n == 0 {
            break;
        }
        bytes += n as u64;
        hasher.update(&buffer[..n]);
        to.write_all(&buffer[..n])?;
    }
    Ok((bytes, Digest(hasher.finalize().into())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_hashed_as_its_files() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("b"), "abc").unwrap();
        std::fs::write(dir.path().join("a"), "").unwrap();
        let hashes = hashes(&[dir.path().into(), dir.path().join("gone")]);
        let of = |i: usize| hashes[i]["sha256"].as_str().unwrap_or("none").to_owned();
        assert_eq!(of(0), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
        assert_eq!(of(1), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert!(hashes[2]["error"].is_string());
    }

    #[cfg(unix)]
    #[test]
    fn what_is_no_regular_file_is_not_read() {
        let dir = tempfile::tempdir().unwrap();
        let (pipe, socket) = (dir.path().join("pipe"), dir.path().join("socket"));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let hashes = hashes(&["/dev/zero".into(), dir.path().into()]);
        let messages: Vec<_> = hashes.iter().map(|entry| entry["error"].as_str().unwrap_or_default()).collect();
        let needed = "but a regular file is needed";
        let expected = ["a device", "a pipe", "a socket"].map(|kind| format!("it is {kind}, {needed}"));
        assert_eq!(messages, expected);
    }
}
