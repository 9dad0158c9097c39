//! What plugins load while their nodes fire, which nobody can know before.

use crate::plan::{Loads, PlanPlugin};
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

/// By the file of the plugin.
static LATE: Mutex<BTreeMap<PathBuf, Loads>> = Mutex::new(BTreeMap::new());

/// Adds what a process has loaded; gives what differs from what others had loaded.
#[cfg(unix)]
pub(super) fn add(plugin: &std::path::Path, loads: &Loads) -> Vec<String> {
    let mut late = LATE.lock().unwrap_or_else(PoisonError::into_inner);
    let late = late.entry(plugin.into()).or_default();
    late.add(loads);
    late.changed(loads)
}

/// How what plugins have loaded meanwhile in this process differs from what they had loaded before.
pub(crate) fn late_difference(plugins: &[PlanPlugin]) -> Option<String> {
    let late = LATE.lock().unwrap_or_else(PoisonError::into_inner);
    plugins.iter().find_map(|plugin| {
        let changed = plugin.loads.changed(late.get(&plugin.path)?);
        (!changed.is_empty()).then(|| format!("plugin {} loads something else: {}", plugin.name, changed.join(", ")))
    })
}

/// The plugins, with what their nodes have loaded meanwhile in this process.
pub(crate) fn with_late_loads(plugins: &[PlanPlugin]) -> Vec<PlanPlugin> {
    let late = LATE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut plugins = plugins.to_vec();
    for plugin in &mut plugins {
        if let Some(more) = late.get(&plugin.path) {
            plugin.loads.add(more);
        }
    }
    plugins
}
