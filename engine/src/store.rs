//! What is worth keeping from one run to the next: bytes by key, in one folder for everything and everyone.
//!
//! A [`Key`] is the SHA-256 of all that decides what lies under it, so an entry is never out of date: what changes has
//! another key. Entries are files that are written aside and renamed into place, so any number of processes may share the
//! folder. Each says its key, its length and its checksum; one that is damaged, cut short or of another format is not
//! there, and is replaced. Above [`Settings::max_bytes`] those go that were not used for longest.
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

pub use entry::Entry;
pub use key::{Key, KeyInMaking};
pub(crate) use payload::{decode, message, payload_of};
pub(crate) use program::{brought, note_plugin, note_program};
pub use settings::{Settings, SettingsError};

use crate::hash::Digest;
use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::SystemTime,
};

/// A folder of entries, as one process uses it; threads may share it.
#[derive(Debug)]
pub struct Store {
    settings: Settings,
    fill: Mutex<Fill>,
}

/// What the folder holds, as far as this process knows.
#[derive(Debug, Default)]
struct Fill {
    /// Bytes when it was last looked through.
    then: Option<u64>,
    /// Bytes that this process has added since.
    since: u64,
}

/// The folder is looked through again when a process has added this share of what it may hold: others add to it too.
const LOOK_AFTER: u64 = 8;

/// An entry that could not be kept.
#[derive(Debug, thiserror::Error)]
#[error(
    "nothing can be kept in the store {}: {source}; OSTEOFLOW_CACHE names another folder, or `off` for none",
    .dir.display()
)]
pub struct StoreError {
    /// The store's folder.
    pub dir: PathBuf,
    /// Why.
    pub source: io::Error,
}

impl Store {
    /// The store of these settings; its folder is made with the first entry.
    pub fn open(settings: Settings) -> Self {
        Self { settings, fill: Mutex::default() }
    }

    /// The store's folder.
    pub fn dir(&self) -> &Path {
        &self.settings.dir
    }

    /// What lies under the key, whole and as it was put there; it then counts as used.
    pub fn get(&self, key: &Key) -> Option<Entry> {
        let path = self.path(key);
        let read = File::open(&path).and_then(|mut file| {
            let entry = Entry::read(&mut file, key)?;
            // Who may read but not change the folder reads on.
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

    /// Keeps bytes, given in pieces, under the key; what lay there is replaced. What is larger than the whole store may be
    /// is not kept.
    ///
    /// # Errors
    /// [`StoreError`] if the folder cannot be made or written. Whatever the bytes are for goes on without.
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

    /// Writes the entry aside and renames it into place.
    fn write(&self, key: &Key, pieces: &[&[u8]]) -> io::Result<()> {
        let (mut file, aside) = self.aside()?;
        let written = entry::head(key, pieces).and_then(|head| {
            file.write_all(&head)?;
            pieces.iter().try_for_each(|piece| file.write_all(piece))?;
            drop(file);
            fs::rename(&aside, self.path(key))
        });
        if written.is_err() {
            let _ = fs::remove_file(&aside);
        }
        // Where an open file cannot be replaced, whoever has it open has the same bytes.
        written.or_else(|error| if self.get(key).is_some() { Ok(()) } else { Err(error) })
    }

    /// A new file that nobody else writes, and that is no entry.
    fn aside(&self) -> io::Result<(File, PathBuf)> {
        static N_MADE: AtomicU64 = AtomicU64::new(0);
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        // Two machines that share the folder may have processes of one number.
        let own = format!("{}-{:x}", std::process::id(), since.as_nanos());
        loop {
            let path = self.dir().join(evict::aside_name(&own, N_MADE.fetch_add(1, Ordering::Relaxed)));
            match File::options().write(true).create_new(true).open(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                made => return made.map(|file| (file, path)),
            }
        }
    }

    /// Removes what was not used for longest, where there is too much.
    fn make_room(&self, n_added: u64) {
        let max_bytes = self.settings.max_bytes;
        let mut fill = self.fill.lock().unwrap_or_else(PoisonError::into_inner);
        fill.since = fill.since.saturating_add(evict::on_disk(n_added));
        let fits = fill.then.is_some_and(|then| then.saturating_add(fill.since) <= max_bytes);
        if fits && fill.since <= max_bytes / LOOK_AFTER {
            return;
        }
        match evict::make_room(self.dir(), max_bytes) {
            Ok(left) => *fill = Fill { then: Some(left), since: 0 },
            Err(error) => tracing::debug!("{} cannot be looked through: {error}", self.dir().display()),
        }
    }

    /// The digest of this program, of the libraries it has loaded, and of what the processor offers: what else decides
    /// the bits of an answer. `None` where the program cannot be read, and then nothing that it computes may be kept.
    pub fn program(&self) -> Option<Digest> {
        program::digest(self)
    }
}

/// Makes the folder for its owner alone: what is kept of a patient's data is a patient's data.
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
