//! Libraries of a recording that have moved since.

use super::{Finder, Kinds};
use crate::{hash::files::sha256, plan::PlanPlugin};
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

impl Kinds {
    /// The kinds with the recorded libraries that are no longer at their path, but in a folder of a library of the command
    /// line or in a folder of plugins, under the same file name and with the same SHA-256.
    #[must_use]
    pub(crate) fn with_moved(&self, recorded: &[PlanPlugin]) -> Self {
        let Some(finder) = &self.finder else { return self.clone() };
        let found: Vec<PathBuf> = recorded.iter().filter_map(|plugin| finder.moved(plugin)).collect();
        if found.is_empty() {
            return self.clone();
        }
        let mut finder = Finder::clone(finder);
        finder.asked.extend(found);
        Self { registry: self.registry.clone(), finder: Some(Arc::new(finder)) }
    }
}

impl Finder {
    fn moved(&self, plugin: &PlanPlugin) -> Option<PathBuf> {
        let recorded = Path::new(&plugin.path);
        let name = recorded.file_name()?;
        // A library of the command line with this name replaces it in any case.
        if recorded.exists() || self.asked.iter().any(|asked| asked.file_name() == Some(name)) {
            return None;
        }
        let beside = self.asked.iter().filter_map(|asked| asked.parent());
        let folders = beside.chain(self.folders.iter().map(PathBuf::as_path));
        let same = |path: &PathBuf| sha256(path).is_ok_and(|(_, digest)| digest.to_string() == *plugin.sha256);
        folders.map(|folder| folder.join(name)).find(same)
    }
}
