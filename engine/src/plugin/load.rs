//! Loads a library into the program, when the first of its nodes is built.

use super::{Library, LibraryError, Plugin, Why};
use crate::{hash::Digest, store};
use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
};

/// The variable that has libraries loaded from where they lie, for debuggers that read them later.
const IN_PLACE: &str = "OSTEOFLOW_PLUGIN_IN_PLACE";
/// Words of a library that looks for others beside itself.
const BESIDE: [&[u8]; 2] = [b"$ORIGIN", b"@loader_path"];

/// What is loaded, by SHA-256; and what was loaded from its own place, which the system would not load again.
static LOADED: Mutex<Loaded> = Mutex::new(Loaded { libraries: BTreeMap::new(), in_place: BTreeMap::new() });

struct Loaded {
    libraries: BTreeMap<Arc<str>, &'static Library>,
    in_place: BTreeMap<PathBuf, Arc<str>>,
}

/// The library of a plugin, loaded once in a process.
///
/// A copy is loaded that nobody else knows: what is written over a library that is in use changes its code while it runs,
/// and a rebuilt one of the same path is another for the system only under another path. A library that looks for others
/// beside itself is loaded where it lies.
pub(super) fn load(plugin: &Plugin) -> Result<&'static Library, String> {
    // What else is loaded from here on belongs to plugins, not to the program.
    store::note_program();
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(library) = loaded.libraries.get(&plugin.sha256) {
        return Ok(library);
    }
    let path = &plugin.path;
    let told = |why: &dyn std::fmt::Display| format!("plugin {}: {why}", path.display());
    let bytes = fs::read(path).map_err(|error| told(&format!("it cannot be read: {error}")))?;
    if Digest::of(&bytes).to_string() != *plugin.sha256 {
        return Err(told(&"it has changed since it was looked at; run again"));
    }
    let needs_place = std::env::var_os(IN_PLACE).is_some_and(|value| !value.is_empty())
        || BESIDE.iter().any(|word| bytes.windows(word.len()).any(|window| window == *word));
    let library = match copy(path, &bytes).ok().filter(|_| !needs_place) {
        Some(copy) => match open(&copy.file) {
            // Programs may not be run from where the copy lies.
            Err(error) if matches!(error.why, Why::Load(_)) => in_place(plugin, &mut loaded)?,
            library => library.map_err(|error| told(&error.why))?,
        },
        None => in_place(plugin, &mut loaded)?,
    };
    if *library.about() != plugin.about {
        return Err(told(
            &"it describes itself otherwise than when it was looked at; it must not depend on its process",
        ));
    }
    let library: &'static Library = Box::leak(Box::new(library));
    loaded.libraries.insert(plugin.sha256.clone(), library);
    Ok(library)
}

/// Loads a file that the store is not to take for a part of the program.
fn open(file: &Path) -> Result<Library, LibraryError> {
    store::note_plugin(file);
    Library::load(file)
}

fn in_place(plugin: &Plugin, loaded: &mut Loaded) -> Result<Library, String> {
    let path = plugin.path.display();
    if loaded.in_place.get(&plugin.path).is_some_and(|sha256| *sha256 != plugin.sha256) {
        return Err(format!(
            "plugin {path}: it was rebuilt while it is in use, and can only be loaded from its place; start the program again"
        ));
    }
    let library = open(&plugin.path).map_err(|error| format!("plugin {path}: {}", error.why))?;
    loaded.in_place.insert(plugin.path.clone(), plugin.sha256.clone());
    Ok(library)
}

const PREFIX: &str = "osteoflow-plugin-";

/// A file that goes when this does; what is mapped of it stays.
struct Copy {
    dir: PathBuf,
    file: PathBuf,
}

fn copy(path: &Path, bytes: &[u8]) -> io::Result<Copy> {
    let mut builder = fs::DirBuilder::new();
    // Nobody else may put a library there.
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    // Under a path that was used before, the system would find what it has loaded.
    static N_MADE: AtomicU32 = AtomicU32::new(0);
    loop {
        let n = N_MADE.fetch_add(1, Ordering::Relaxed);
        let dir = std::env::temp_dir().join(format!("{PREFIX}{}-{n}", std::process::id()));
        match builder.create(&dir) {
            Ok(()) => {
                let copy = Copy { file: dir.join(path.file_name().unwrap_or_default()), dir };
                fs::write(&copy.file, bytes)?;
                return Ok(copy);
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
}

impl Drop for Copy {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.dir);
    }
}
