//! Copies of a plugin and of the modules beside it, from which a command runs that goes on while they are edited.

use super::Plugin;
use serde_json::json;
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Copies the plugin into the folder `to`; gives the copy of a library, or the folder of a script with its `index.json`: name,
/// path and copy of each module. Modules that are no text, and libraries that a library needs, stay where they are.
///
/// # Errors
/// If a file cannot be read or written.
pub(super) fn copy(plugin: &Plugin, to: &Path) -> io::Result<PathBuf> {
    fs::create_dir_all(to)?;
    if plugin.script.is_none() {
        let file = to.join(plugin.path.file_name().unwrap_or_default());
        fs::copy(&plugin.path, &file)?;
        return Ok(file);
    }
    let modules = plugin.description.loads.files.iter().map(|file| (&*file.name, &file.path));
    let modules = modules.filter(|(_, path)| path.extension() == plugin.path.extension());
    let mut index = Vec::new();
    for (number, (name, path)) in [("__plugin__", &plugin.path)].into_iter().chain(modules).enumerate() {
        fs::copy(path, to.join(number.to_string()))?;
        index.push(json!([name, path, number.to_string()]));
    }
    fs::write(to.join("index.json"), json!(index).to_string())?;
    Ok(to.into())
}
