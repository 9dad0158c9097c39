use super::tree::{Table, Value};
use crate::fault::{Fault, Span};
use std::path::{Path, PathBuf};

/// A plugin that a graph names.
#[derive(Debug, Clone)]
pub(crate) struct NamedPlugin {
    pub(crate) text: String,
    /// The folder that its path is relative to.
    pub(crate) dir: PathBuf,
    pub(crate) at: Option<Span>,
}

impl NamedPlugin {
    /// A plugin file that a recording names.
    pub(crate) fn file(path: &Path) -> Self {
        Self { text: path.display().to_string(), dir: PathBuf::new(), at: None }
    }
}

/// Removes `plugins` from a file's table and returns the plugins it names.
pub(super) fn take(table: &mut Table, faults: &mut Vec<Fault>) -> Vec<NamedPlugin> {
    let Some(entry) = table.remove("plugins") else { return Vec::new() };
    let Value::Array(items) = &entry.value.value else {
        let message = format!("plugins takes a list of libraries, found {}", entry.value.found());
        let fault = Fault::new(message).at(&entry.value.at, "a list is needed");
        faults.push(fault.help("write plugins = [\"libmy_nodes.so\"]"));
        return Vec::new();
    };
    let named = items.iter().filter_map(|item| match item.as_text() {
        Some(text) => Some(NamedPlugin { text: text.into(), dir: item.at.dir().into(), at: Some(item.at.clone()) }),
        None => {
            let fault = Fault::new(format!("a plugin is named by the path of its library, found {}", item.found()));
            faults.push(fault.at(&item.at, "a text is needed"));
            None
        }
    });
    named.collect()
}
