//! Loads a plugin's library when the first of its nodes is built.

use super::{Library, Plugin, Why};
use crate::{
    hash::{Digest, files::sha256, mapped::mapped},
    plan::{LoadedFile, Loads},
    temporary,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

/// Environment variable that loads libraries from their own path, for debuggers that read them later.
const IN_PLACE: &str = "OSTEOFLOW_PLUGIN_IN_PLACE";
/// Markers in a library that searches for others in its own folder.
const BESIDE: [&[u8]; 2] = [b"$ORIGIN", b"@loader_path"];

/// The loaded libraries by SHA-256, and those loaded from their own path, which the system would not load again.
static LOADED: Mutex<Loaded> = Mutex::new(Loaded { libraries: BTreeMap::new(), in_place: BTreeMap::new() });

struct Loaded {
    libraries: BTreeMap<Arc<str>, &'static Library>,
    in_place: BTreeMap<PathBuf, Arc<str>>,
}

/// Loads the library of a plugin, once per process.
///
/// Loads a private copy: overwriting a loaded library would change its running code, and the system loads a rebuilt
/// library again only from another path. A library that searches for others in its own folder is loaded from its own
/// path.
pub(super) fn load(plugin: &Plugin) -> Result<&'static Library, String> {
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(library) = loaded.libraries.get(&plugin.sha256) {
        return Ok(library);
    }
    let path = &plugin.path;
    let message = |why: &dyn std::fmt::Display| format!("plugin {}: {why}", path.display());
    if plugin.script.is_some() {
        return Err(message(&"it is a script, whose nodes fire in processes of their own; take process = false out"));
    }
    let file = plugin.copy.as_deref().unwrap_or(path);
    let bytes =
        crate::regular(file).and_then(fs::read).map_err(|error| message(&format!("it cannot be read: {error}")))?;
    if Digest::of(&bytes).to_string() != *plugin.sha256 {
        return Err(message(&"it has changed since it was looked at; run again"));
    }
    let needs_place = std::env::var_os(IN_PLACE).is_some_and(|value| !value.is_empty())
        || BESIDE.iter().any(|word| bytes.windows(word.len()).any(|window| window == *word));
    let library = match copy(path, &bytes).ok().filter(|_| !needs_place) {
        Some((_folder, file)) => match Library::load(&file) {
            // The folder of the copy may not allow execution.
            Err(error) if matches!(error.why, Why::Load(_)) => in_place(plugin, &mut loaded)?,
            library => library.map_err(|error| message(&error.why))?,
        },
        None => in_place(plugin, &mut loaded)?,
    };
    if !library.description().is_same(&plugin.description) {
        return Err(message(
            &"it describes itself otherwise than when it was looked at; it must not depend on its process",
        ));
    }
    check_loads(&plugin.description.loads).map_err(|why| message(&why))?;
    let library: &'static Library = Box::leak(Box::new(library.shown_as(path)));
    loaded.libraries.insert(plugin.sha256.clone(), library);
    Ok(library)
}

/// Checks that the libraries which this one needs are as they were when it was looked at.
fn check_loads(loads: &Loads) -> Result<(), String> {
    let changed = |file: &&LoadedFile| sha256(&file.path).map_or(true, |(_, digest)| digest.to_string() != file.sha256);
    match loads.files.iter().find(changed) {
        Some(LoadedFile { name, path, .. }) => {
            Err(format!("{name} ({}) has changed since it was looked at; run again", path.display()))
        }
        None => Ok(()),
    }
}

/// The libraries mapped since, by content; none of the plugin's own files.
pub(super) fn loads_since(before: &BTreeSet<PathBuf>, own: &Path) -> Loads {
    let is_own = |path: &PathBuf| path == own || path.file_name() == own.file_name();
    let loaded = |path: PathBuf| {
        let sha256 = sha256(&path).map_or_else(|error| error.to_string(), |(_, digest)| digest.to_string());
        Some(LoadedFile { name: path.file_name()?.to_string_lossy().into_owned(), path, sha256 })
    };
    let new = mapped().into_iter().filter(|path| !before.contains(path) && !is_own(path));
    Loads { files: new.filter_map(loaded).collect(), ..Loads::default() }
}

fn in_place(plugin: &Plugin, loaded: &mut Loaded) -> Result<Library, String> {
    let path = plugin.path.display();
    if loaded.in_place.get(&plugin.path).is_some_and(|sha256| *sha256 != plugin.sha256) {
        return Err(format!(
            "plugin {path}: it was rebuilt while it is in use, and can only be loaded from its place; start the program again"
        ));
    }
    let library = Library::load(&plugin.path).map_err(|error| format!("plugin {path}: {}", error.why))?;
    loaded.in_place.insert(plugin.path.clone(), plugin.sha256.clone());
    Ok(library)
}

/// A copy of the library in a folder that is deleted on drop; the mapped pages of the file stay valid.
fn copy(path: &Path, bytes: &[u8]) -> io::Result<(tempfile::TempDir, PathBuf)> {
    let folder = temporary::folder("plugin")?;
    let file = folder.path().join(path.file_name().unwrap_or_default());
    fs::write(&file, bytes)?;
    Ok((folder, file))
}
