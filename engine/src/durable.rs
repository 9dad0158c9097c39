//! Files that are whole or absent, also after a power cut or on a full disk.
//!
//! [`write`] writes a side file, syncs it, renames it and syncs its folder, so a reader finds the old file or the new
//! one. A link of its name is replaced, never written through.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU32, Ordering},
};

/// Writes a file atomically and durably.
///
/// # Errors
/// If the file cannot be written, for example because the disk is full; an earlier file of this name is then unchanged.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let part = side_file(path);
    let written = create(&part).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()?;
        drop(file);
        fs::rename(&part, path)
    });
    if written.is_err() {
        let _ = fs::remove_file(&part);
    }
    written?;
    sync_folder_of(path)
}

/// Creates a new file; a file or link of this name is removed first.
///
/// # Errors
/// If it cannot be created.
pub fn create(path: &Path) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    File::options().write(true).create_new(true).open(path)
}

/// Writes the folder that holds a file to the disk, so that the file's name outlasts a power cut.
///
/// # Errors
/// If the system reports one. Systems that cannot sync a folder are passed over.
pub fn sync_folder_of(path: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => Ok(()),
        synced => synced,
    }
}

/// A new folder of this process among the system's temporary files, which is removed on drop. Only its owner may use it.
#[derive(Debug)]
pub(crate) struct TemporaryFolder(PathBuf);

impl TemporaryFolder {
    /// # Errors
    /// If it cannot be created.
    pub(crate) fn new(prefix: &str) -> io::Result<Self> {
        // A library is not loaded again from a path that was used before.
        static N_MADE: AtomicU32 = AtomicU32::new(0);
        #[cfg_attr(not(unix), allow(unused_mut, reason = "only Unix has permissions to set"))]
        let mut builder = fs::DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
        loop {
            let n = N_MADE.fetch_add(1, Ordering::Relaxed);
            let dir = std::env::temp_dir().join(format!("{prefix}-{}-{n}", std::process::id()));
            match builder.create(&dir) {
                Ok(()) => return Ok(Self(dir)),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A name beside the file that no other process uses.
fn side_file(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_no_side_file_stays() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("results.json");
        for text in ["a longer text", "short"] {
            write(&path, text.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        assert!(write(&dir.path().join("none/results.json"), b"x").is_err());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_replaced_and_not_written_through() {
        let dir = tempfile::tempdir().unwrap();
        let (path, elsewhere) = (dir.path().join("results.json"), dir.path().join("elsewhere"));
        fs::write(&elsewhere, "mine").unwrap();
        for link in [path.clone(), side_file(&path)] {
            std::os::unix::fs::symlink(&elsewhere, &link).unwrap();
            write(&path, b"new").unwrap();
            assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "mine");
            assert_eq!(fs::read_to_string(&path).unwrap(), "new");
            assert!(!path.is_symlink());
            fs::remove_file(&path).unwrap();
        }
    }
}
