//! The text of plugins that a recording carries: written with it, and run only if the user trusts it.

use super::{Finder, Kinds};
use crate::{
    hash::Digest,
    plan::{LoadedFile, PlanPlugin},
    temporary,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    ffi::OsStr,
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Largest file whose text is recorded. A module of this length is data.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Most bytes of text in a recording.
const MAX_BYTES: u64 = 16 << 20;

/// Text of files by their SHA-256.
pub(crate) type Texts = BTreeMap<String, String>;

/// The file of a plugin that is a script, and its modules; nothing of a library.
fn files(plugin: &PlanPlugin) -> impl Iterator<Item = (&Path, &str)> {
    let ending =
        plugin.path.extension().filter(|ending| ["so", "dylib", "dll"].iter().all(|library| ending != library));
    let own = ending.is_some().then_some((&*plugin.path, &*plugin.sha256));
    own.into_iter().chain(modules(plugin, ending).map(|file| (&*file.path, &*file.sha256)))
}

/// The modules of a script.
fn modules<'a>(plugin: &'a PlanPlugin, ending: Option<&'a OsStr>) -> impl Iterator<Item = &'a LoadedFile> {
    plugin.loads.files.iter().filter(move |file| ending.is_some() && file.path.extension() == ending)
}

/// The text of the scripts among the plugins and of their modules, and why that of a file is left out.
pub(crate) fn texts(plugins: &[PlanPlugin]) -> (Texts, Vec<String>) {
    let (mut texts, mut left_out, mut n_bytes) = (Texts::new(), Vec::new(), 0);
    for (path, sha256) in plugins.iter().flat_map(files) {
        if texts.contains_key(sha256) {
            continue;
        }
        match text(path, sha256, MAX_BYTES - n_bytes) {
            Ok(text) => {
                n_bytes += text.len() as u64;
                texts.insert(sha256.into(), text);
            }
            Err(why) => left_out.push(format!("the recording does not hold the text of {}: {why}", path.display())),
        }
    }
    (texts, left_out)
}

/// The text of a file that has not changed.
fn text(path: &Path, sha256: &str, n_left: u64) -> Result<String, String> {
    let unread = |error: io::Error| error.to_string();
    let n_bytes = fs::metadata(path).map_err(unread)?.len();
    if n_bytes > MAX_FILE_BYTES {
        return Err(format!("it has {n_bytes} bytes, and at most {MAX_FILE_BYTES} of a file are recorded"));
    }
    if n_bytes > n_left {
        return Err(format!("with it there would be more than {MAX_BYTES} bytes of text in the recording"));
    }
    let bytes = crate::regular(path).and_then(fs::read).map_err(unread)?;
    if Digest::of(&bytes).to_string() != sha256 {
        return Err("it has changed since it was looked at".into());
    }
    String::from_utf8(bytes).map_err(|_| "it is not UTF-8".into())
}

/// The plugins whose own text is there.
pub(crate) fn carried<'a>(plugins: &'a [PlanPlugin], texts: &'a Texts) -> impl Iterator<Item = &'a PlanPlugin> {
    plugins.iter().filter(|plugin| files(plugin).next().is_some() && texts.contains_key(&plugin.sha256))
}

impl Kinds {
    /// The kinds with those of the plugins whose text a recording carries, from a folder that is removed on drop. A file that the
    /// command line names takes the place of one with its name.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(crate) fn with_carried(&self, plugins: &[PlanPlugin], texts: &Texts) -> io::Result<(Self, tempfile::TempDir)> {
        let folder = temporary::folder("recorded-plugins")?;
        let Some(finder) = &self.finder else { return Ok((self.clone(), folder)) };
        let mut finder = Finder::clone(finder);
        for (number, plugin) in carried(plugins, texts).enumerate() {
            let Some(name) = plugin.path.file_name() else { continue };
            if finder.asked.iter().any(|asked| asked.file_name() == Some(name)) {
                continue;
            }
            let dir = folder.path().join(number.to_string());
            fs::create_dir(&dir)?;
            for module in modules(plugin, plugin.path.extension()) {
                if let (Some(to), Some(text)) = (place(module), texts.get(&module.sha256)) {
                    let to = dir.join(to);
                    fs::create_dir_all(to.parent().unwrap_or(&dir))?;
                    fs::write(to, text)?;
                }
            }
            fs::write(dir.join(name), &texts[&plugin.sha256])?;
            finder.asked.push(dir.join(name));
        }
        Ok((Self { registry: self.registry.clone(), finder: Some(Arc::new(finder)) }, folder))
    }

    /// The kinds whose refusals of these files say that the recording carries their text.
    pub(crate) fn naming_carried(&self, plugins: &[PlanPlugin], texts: &Texts) -> Self {
        let carried: BTreeSet<PathBuf> = carried(plugins, texts).map(|plugin| plugin.path.clone()).collect();
        let finder = self.finder.as_ref().map(|finder| Arc::new(Finder { carried, ..Finder::clone(finder) }));
        Self { registry: self.registry.clone(), finder }
    }
}

/// Where a module is found by its name: `a/b.py` for `a.b`, `a/__init__.py` for a package. `None` if its name is none of a module,
/// such as one that leads out of the folder.
fn place(module: &LoadedFile) -> Option<PathBuf> {
    let is_name = |part: &str| !part.is_empty() && part.chars().all(|c| c.is_alphanumeric() || c == '_');
    if !module.name.split('.').all(is_name) {
        return None;
    }
    let path: PathBuf = module.name.split('.').collect();
    let file = module.path.file_name()?;
    match module.path.file_stem()? == "__init__" {
        true => Some(path.join(file)),
        false => Some(path.with_extension(module.path.extension()?)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_lies_where_its_name_says_and_nowhere_else() {
        let place =
            |name: &str, path: &str| place(&LoadedFile { name: name.into(), path: path.into(), sha256: String::new() });
        assert_eq!(place("helper", "/x/helper.py"), Some("helper.py".into()));
        assert_eq!(place("a.b", "/x/a/b.py"), Some("a/b.py".into()));
        assert_eq!(place("a", "/x/a/__init__.py"), Some("a/__init__.py".into()));
        assert!(["..", "../../x", "/etc/x", "a..b", ""].iter().all(|name| place(name, "/x/helper.py").is_none()));
    }
}
