//! Files found by their contents.

use anyhow::{Context, Result};
use osteoflow_engine::hash::sha256;
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// The files below folders, by size; hashed only where a size is asked for.
#[derive(Debug, Default)]
pub(super) struct Search {
    by_size: BTreeMap<u64, Vec<PathBuf>>,
}

impl Search {
    /// All files in the folders and below.
    ///
    /// # Errors
    /// A folder cannot be read.
    pub(super) fn below(folders: &[PathBuf]) -> Result<Self> {
        let mut search = Self::default();
        folders.iter().try_for_each(|folder| search.list(folder))?;
        Ok(search)
    }

    fn list(&mut self, path: &Path) -> Result<()> {
        let about = fs::metadata(path).with_context(|| format!("{} cannot be read", path.display()))?;
        if about.is_file() {
            self.by_size.entry(about.len()).or_default().push(path.into());
        } else if about.is_dir() {
            let entries = fs::read_dir(path).with_context(|| format!("{} cannot be read", path.display()))?;
            let mut entries = entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
            entries.sort();
            // A link to a folder may lead back; a broken one leads nowhere.
            entries.retain(|path| !path.is_symlink() || path.is_file());
            entries.iter().try_for_each(|path| self.list(path))?;
        }
        Ok(())
    }

    /// A file with this content.
    pub(super) fn find(&self, bytes: u64, digest: &str) -> Option<PathBuf> {
        self.by_size.get(&bytes)?.iter().find(|path| has_content(path, bytes, digest)).cloned()
    }
}

/// Whether the file has this content.
pub(super) fn has_content(path: &Path, bytes: u64, digest: &str) -> bool {
    fs::metadata(path).is_ok_and(|about| about.is_file() && about.len() == bytes)
        && sha256(path).is_ok_and(|(_, found)| found.to_string() == digest)
}
