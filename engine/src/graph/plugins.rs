use super::{
    extract::{Section, refused},
    grammar,
    tree::{Spanned, Table, Value},
};
use crate::fault::{Fault, Span};
use std::path::{Path, PathBuf};

/// A plugin that a graph names.
#[derive(Debug, Clone)]
pub(crate) struct NamedPlugin {
    pub(crate) text: String,
    /// The interpreter that the graph names for it, absolute.
    pub(crate) interpreter: Option<PathBuf>,
    /// The folder that its path is relative to.
    pub(crate) dir: PathBuf,
    pub(crate) at: Option<Span>,
}

impl NamedPlugin {
    /// A plugin file that a recording names.
    pub(crate) fn file(path: &Path) -> Self {
        Self { text: path.display().to_string(), interpreter: None, dir: PathBuf::new(), at: None }
    }
}

/// Removes `plugins` from a file's table and returns the plugins it names.
pub(super) fn take(table: &mut Table, faults: &mut Vec<Fault>) -> Vec<NamedPlugin> {
    let Some(entry) = table.remove("plugins") else { return Vec::new() };
    let Value::Array(items) = &entry.value.value else {
        let fault = refused(&entry.value, "plugins takes a list of libraries", "a list is needed");
        faults.push(fault.help("write plugins = [\"libmy_nodes.so\"]"));
        return Vec::new();
    };
    items.iter().filter_map(|item| plugin(item, faults)).collect()
}

/// A plugin: the path of its file, or a table of file and interpreter.
fn plugin(item: &Spanned, faults: &mut Vec<Fault>) -> Option<NamedPlugin> {
    let (dir, at) = (item.at.dir().to_path_buf(), Some(item.at.clone()));
    if let Some(text) = item.as_text() {
        return Some(NamedPlugin { text: text.into(), interpreter: None, dir, at });
    }
    let Some(table) = item.as_table() else {
        faults.push(refused(item, "a plugin is named by the path of its file", "a text is needed"));
        return None;
    };
    let table = Section::new(table, &grammar::PLUGIN, "a plugin", "", faults);
    let (file, interpreter) = (table.text("file", faults), table.text("interpreter", faults));
    let Some(text) = file.map(str::to_owned) else {
        let fault = Fault::new("a plugin is named by the path of its file");
        faults.push(
            fault.at(&item.at, "no file").help("write { file = \"my_icp.py\", interpreter = \".venv/bin/python\" }"),
        );
        return None;
    };
    // A name without a folder is looked for by the system.
    let interpreter = interpreter.map(|name| if name.contains('/') { dir.join(name) } else { name.into() });
    Some(NamedPlugin { text, interpreter, dir, at })
}
