//! Persistent cache: bytes by key, in one folder that all processes share.
//!
//! A [`Key`] is the SHA-256 of all inputs that determine an entry, so entries are never stale: changed inputs have
//! another key. Entries are written to a temporary file and renamed, so any number of processes may share the folder.
//! Each entry holds its key, length and checksum; an entry that is damaged, truncated or of another format is treated
//! as missing and replaced. Above [`Settings::max_bytes`] the least recently used entries are removed.
//!
//! ```
//! use osteoflow_engine::store::{Key, Settings, Store};
//!
//! let dir = tempfile::tempdir()?;
//! let store = Store::open(Settings::in_dir(dir.path()));
//! let key = Key::of("example").text("file", "bone.stl").done();
//! assert!(store.get(&key).is_none());
//! store.put(&key, &[b"what took long ", b"to compute"])?;
//! assert_eq!(store.get(&key).unwrap().bytes(), b"what took long to compute");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod entry;
mod evict;
mod key;
mod payload;
mod program;
mod settings;
#[cfg(test)]
mod tests;

pub use entry::StoreEntry;
pub use key::{Key, KeyBuilder};
pub(crate) use payload::{decode, message, payload_of};
pub use program::{cpu_features, libraries};
pub use settings::{Settings, SettingsError};

use crate::{durable::Part, hash::Digest};
use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::SystemTime,
};

/// A folder of entries, as one process uses it; threads may share it.
#[derive(Debug)]
pub struct Store {
    settings: Settings,
    fill: Mutex<Fill>,
}

/// Size of the folder, as far as this process knows.
#[derive(Debug, Default)]
struct Fill {
    /// Bytes at the last scan.
    scanned: Option<u64>,
    /// Bytes that this process has added since the last scan.
    added: u64,
}

/// The folder is rescanned when this process has added 1/8 of the maximum size: other processes add entries too.
const RESCAN_SHARE: u64 = 8;

/// An entry could not be stored.
#[derive(Debug, thiserror::Error)]
#[error(
    "nothing can be kept in the store {}: {source}; OSTEOFLOW_CACHE names another folder, or `off` for none",
    .dir.display()
)]
pub struct StoreError {
    /// The store's folder.
    pub dir: PathBuf,
    /// The cause.
    pub source: io::Error,
}

impl Store {
    /// A store with these settings; the folder is created with the first entry.
    pub fn open(settings: Settings) -> Self {
        Self { settings, fill: Mutex::default() }
    }

    /// The store's folder.
    pub fn dir(&self) -> &Path {
        &self.settings.dir
    }

    /// The complete entry of the key, if there is one; marks it as used.
    pub fn get(&self, key: &Key) -> Option<StoreEntry> {
        let path = self.path(key);
        let read = File::open(&path).and_then(|mut file| {
            let entry = StoreEntry::read(&mut file, key)?;
            // The folder may be read-only for this user; then the time of use is not updated.
            let _ = entry.is_some().then(|| file.set_modified(SystemTime::now()));
            Ok(entry)
        });
        match &read {
            Ok(None) => tracing::debug!("{} is damaged or of another format, and is passed over", path.display()),
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                tracing::debug!("{} is passed over: {error}", path.display());
            }
            _ => {}
        }
        read.ok().flatten()
    }

    /// Stores bytes, given in pieces, under the key and replaces an older entry. An entry larger than the store's
    /// maximum is not stored.
    ///
    /// # Errors
    /// [`StoreError`] if the folder cannot be created or written. Callers can go on without the entry.
    pub fn put(&self, key: &Key, pieces: &[&[u8]]) -> Result<(), StoreError> {
        let n_bytes = entry::n_bytes(pieces);
        if n_bytes > self.settings.max_bytes {
            tracing::debug!("{n_bytes} bytes are not kept: the store holds {}", self.settings.max_bytes);
            return Ok(());
        }
        let written = make_dir(self.dir()).and_then(|()| self.write(key, pieces));
        written.map_err(|source| StoreError { dir: self.dir().into(), source })?;
        self.make_room(n_bytes);
        Ok(())
    }

    fn path(&self, key: &Key) -> PathBuf {
        self.dir().join(evict::entry_name(key))
    }

    /// Writes the entry to a temporary file and renames it.
    fn write(&self, key: &Key, pieces: &[&[u8]]) -> io::Result<()> {
        let written = Part::new(&self.path(key)).and_then(|mut part| {
            part.file().write_all(&entry::header(key, pieces)?)?;
            pieces.iter().try_for_each(|piece| part.file().write_all(piece))?;
            part.swap()
        });
        // Some platforms cannot replace an open file; a reader of that file has the same bytes.
        written.or_else(|error| if self.get(key).is_some() { Ok(()) } else { Err(error) })
    }

    /// Removes the least recently used entries if the store is too large.
    fn make_room(&self, n_added: u64) {
        let max_bytes = self.settings.max_bytes;
        let mut fill = self.fill.lock().unwrap_or_else(PoisonError::into_inner);
        fill.added = fill.added.saturating_add(evict::on_disk(n_added));
        let fits = fill.scanned.is_some_and(|scanned| scanned.saturating_add(fill.added) <= max_bytes);
        if fits && fill.added <= max_bytes / RESCAN_SHARE {
            return;
        }
        match evict::make_room(self.dir(), max_bytes) {
            Ok(left) => *fill = Fill { scanned: Some(left), added: 0 },
            Err(error) => tracing::debug!("{} cannot be looked through: {error}", self.dir().display()),
        }
    }

    /// The digest of this program, the libraries it has loaded and the processor's features, which also determine the
    /// bits of an answer. `None` if the program cannot be read; then none of its answers may be stored.
    pub fn program(&self) -> Option<Digest> {
        program::digest(self)
    }
}

/// Creates the folder with access for its owner only: entries may contain patient data.
fn make_dir(dir: &Path) -> io::Result<()> {
    if dir.is_dir() {
        return Ok(());
    }
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(dir)
}
