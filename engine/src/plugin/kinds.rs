//! The kinds that graphs may name: the program's own, and those of plugins.

use super::{Launcher, PluginDescription, Prober, ProvideError, copies, load, probe, provide};
use crate::{
    fault::{Fault, Span},
    graph::plugins::NamedPlugin,
    hash::{Digest, file_stamp::stamp, files::sha256},
    names::nearest,
    plan::{LoadedFile, PlanPlugin},
    process::REFUSED_HERE,
    store::{Key, Store},
    temporary,
};
#[cfg(unix)]
use osteoflow_node::PayloadType;
use osteoflow_node::{Registry, abi};
use serde::{Deserialize, Serialize};
use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
    env::consts::{DLL_EXTENSION, DLL_PREFIX, DLL_SUFFIX},
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

/// Environment variables that limit the threads of libraries for arrays, as the module of nodes in Python lists them.
const THREAD_LIMITS: [&str; 6] = [
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OSTEOFLOW_NUM_THREADS",
];

/// The kinds of a program, and where to find plugins. A [`Registry`] converts to the kinds of a program without
/// plugins.
#[derive(Debug, Clone)]
pub struct Kinds {
    pub(super) registry: Registry,
    pub(super) finder: Option<Arc<Finder>>,
}

/// Finds plugins and reads their descriptions.
#[derive(Debug, Clone)]
pub struct Finder {
    /// Reads the description of a library.
    pub prober: Prober,
    /// Where descriptions are cached.
    pub store: Option<Arc<Store>>,
    /// Libraries from the command line; each replaces a library of the graph with the same file name.
    pub asked: Vec<PathBuf>,
    /// Folders whose libraries are all read, and which are searched for names without a folder.
    pub folders: Vec<PathBuf>,
    /// Starts the processes of nodes that have one of their own; `None` if this program runs none.
    pub launcher: Option<Launcher>,
    /// Runs plugins that are scripts; `None` if this program runs none.
    pub scripts: Option<Scripts>,
    /// The SHA-256 of the files that a graph may name; `None` for all. Of the files that a recording names, only those that
    /// the run had loaded may be, since loading one runs its code. The command line and the folders are the user's.
    pub only: Option<BTreeSet<String>>,
    /// The plugins that the run had loaded: of these no module or library is run, either, that is another by now.
    pub recorded: Vec<PlanPlugin>,
    /// Files of plugins whose text the recording carries, which a refusal of one of them says.
    pub carried: BTreeSet<PathBuf>,
    /// Whether the kinds of plugins fire in processes of their own where the graph does not say.
    pub plugins_apart: bool,
    /// Plugins as they were when they were looked at first, for commands that run many times; `None` looks anew each time.
    pub held: Option<Arc<Held>>,
}

/// Plugins, with copies of their files and of the modules beside them.
#[derive(Debug)]
pub struct Held {
    folder: tempfile::TempDir,
    plugins: Mutex<BTreeMap<PathBuf, Plugin>>,
}

/// Plugins in an interpreted language: `INTERPRETER ARGUMENTS describe FILE` prints the description of a file as the prober does
/// that of a library, `INTERPRETER ARGUMENTS serve FILE` serves a node over standard input.
#[derive(Debug, Clone)]
pub struct Scripts {
    /// The ending of their files.
    pub ending: &'static str,
    /// The interpreter, with the arguments before `describe` or `serve`.
    pub interpreter: Launcher,
}

/// A library that is a plugin.
#[derive(Debug, Clone, PartialEq)]
pub struct Plugin {
    /// The file, absolute.
    pub path: PathBuf,
    /// Its SHA-256.
    pub sha256: Arc<str>,
    /// Hash of the file and what it loads.
    pub identity: Arc<str>,
    /// A copy of the file, or of a script a folder with copies of it and of its modules, which is loaded in its stead.
    pub copy: Option<PathBuf>,
    /// Its description.
    pub description: PluginDescription,
    /// Whether the graph names it.
    pub named: bool,
    /// What serves its nodes, if it is a script.
    pub script: Option<Launcher>,
    /// Whether the graph names its interpreter.
    pub names_interpreter: bool,
}

impl Plugin {
    /// The plugin as recorded in a plan, with its kinds that the graph uses.
    pub(crate) fn in_plan(&self, kinds: Vec<String>) -> PlanPlugin {
        PlanPlugin {
            name: self.description.name.clone(),
            version: self.description.version.clone(),
            path: self.path.clone(),
            sha256: self.sha256.to_string(),
            abi: self.description.abi,
            sdk: self.description.sdk.clone(),
            compiler: self.description.compiler.clone(),
            interpreter: self.script.as_ref().filter(|_| self.names_interpreter).map(|script| script.program.clone()),
            kinds,
            loads: self.description.loads.clone(),
        }
    }
}

/// A description, and the stamps of the files that decide it.
#[derive(Serialize, Deserialize)]
struct Look {
    description: PluginDescription,
    stamps: Vec<Option<String>>,
}

impl Look {
    /// The stamps of the files beside the plugin's own, and the modules of folders; `None` for one that is not there.
    fn stamps(description: &PluginDescription) -> Vec<Option<String>> {
        let is_module = |path: &Path| match path.extension() {
            Some(ending) => ["py", "so", "pyd", "pth", "zip", "egg"].iter().any(|other| ending == *other),
            None => path.join("__init__.py").is_file(),
        };
        let modules = |folder: &Path| -> Option<String> {
            let entries = fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
            let names: BTreeSet<_> = entries.filter(|path| is_module(path)).collect();
            Some(Digest::of(format!("{names:?}").as_bytes()).to_string())
        };
        let files = description.loads.files.iter().map(|file| &file.path).chain(&description.watched);
        let stamp_of = |file: &PathBuf| match fs::metadata(file).ok()? {
            about if about.is_dir() => modules(file),
            about => Some(stamp(&about)),
        };
        files.map(stamp_of).collect()
    }

    fn is_current(&self) -> bool {
        self.stamps == Self::stamps(&self.description)
    }
}

/// All kinds and payloads, with the plugins that provide them.
#[derive(Debug)]
pub struct Known {
    /// All kinds and payloads.
    pub registry: Registry,
    /// The plugins, in the order in which they were added.
    pub plugins: Vec<Arc<Plugin>>,
    /// Libraries that are not plugins, or that conflict with others.
    pub refused: Vec<Refused>,
}

/// A plugin that was refused.
#[derive(Debug, Clone)]
pub struct Refused {
    /// The file, or the name for which none was found.
    pub path: PathBuf,
    /// Why.
    pub why: String,
    origin: Origin,
    note: Option<String>,
    help: Option<String>,
}

/// Where a plugin is named.
#[derive(Debug, Clone)]
enum Origin {
    /// A graph, with the name as written.
    Graph(String, Option<Span>),
    /// The command line.
    Asked,
    /// A searched folder.
    Folder,
}

impl From<&Registry> for Kinds {
    fn from(registry: &Registry) -> Self {
        Self { registry: registry.clone(), finder: None }
    }
}

impl From<&Self> for Kinds {
    fn from(kinds: &Self) -> Self {
        kinds.clone()
    }
}

impl Kinds {
    /// The kinds of a program that loads plugins.
    pub fn new(registry: Registry, finder: Finder) -> Self {
        Self { registry, finder: Some(Arc::new(finder)) }
    }

    /// The program's own kinds.
    pub fn registry(&self) -> &Registry {
        &self.registry
    }

    /// The kinds for a graph of a recording or a bundle that names these plugins: of them and of the modules beside them only those are
    /// run that are as they were.
    #[must_use]
    pub fn recorded_by(&self, plugins: &[PlanPlugin]) -> Self {
        let Self { registry, finder } = self.only(plugins);
        let held_to = |finder| Arc::new(Finder { recorded: plugins.to_vec(), ..Arc::unwrap_or_clone(finder) });
        Self { registry, finder: finder.map(held_to) }
    }

    /// The kinds for a graph that may name these plugins alone.
    #[must_use]
    pub fn only(&self, plugins: &[PlanPlugin]) -> Self {
        let only = plugins.iter().map(|plugin| plugin.sha256.clone()).collect();
        let finder = self.finder.as_ref().map(|finder| Arc::new(Finder { only: Some(only), ..Finder::clone(finder) }));
        Self { registry: self.registry.clone(), finder }
    }

    /// The kinds for a command that runs many times: a plugin that is saved meanwhile changes none of its runs, and threads of
    /// libraries are limited to one where the user does not say, since as many runs go on as there are processors.
    ///
    /// # Errors
    /// If there is no folder for copies.
    pub fn held(&self) -> io::Result<Self> {
        let hold = |finder: &Arc<Finder>| -> io::Result<_> {
            let mut finder = Finder::clone(finder);
            let held = Held { folder: temporary::folder("plugins")?, plugins: Mutex::default() };
            finder.held = Some(Arc::new(held));
            if let Some(scripts) = &mut finder.scripts {
                let unset = THREAD_LIMITS.into_iter().filter(|name| std::env::var_os(name).is_none());
                scripts.interpreter.environment.extend(unset.map(|name| (name, "1".into())));
            }
            Ok(Arc::new(finder))
        };
        Ok(Self { registry: self.registry.clone(), finder: self.finder.as_ref().map(hold).transpose()? })
    }

    /// The kinds with another registry of the program's own kinds.
    #[must_use]
    pub fn over(&self, registry: Registry) -> Self {
        Self { registry, finder: self.finder.clone() }
    }

    /// The kinds available without a graph.
    pub fn known(&self) -> Known {
        self.with(&[])
    }

    /// The kinds available to a graph that names these plugins. Plugins named by the graph or the command line take
    /// precedence: a plugin of a folder that conflicts with one of them is left out.
    pub(crate) fn with(&self, named: &[NamedPlugin]) -> Known {
        let mut known = Known { registry: self.registry.clone(), plugins: Vec::new(), refused: Vec::new() };
        let Some(finder) = &self.finder else {
            let why = "no plugins are loaded here";
            known.refused.extend(named.iter().map(|named| Refused::of(named, why.into())));
            return known;
        };
        let asked: Vec<_> =
            finder.asked.iter().map(|path| (path, find(path, &finder.places(Path::new(""), path)))).collect();
        for (path, found) in &asked {
            match found {
                Some(found) => known.add(finder, found, None, Origin::Asked),
                None => known.refused.push(finder.not_found(path, &finder.places(Path::new(""), path), Origin::Asked)),
            }
        }
        for named in named {
            let text = Path::new(&named.text);
            let names = names(text);
            let stands_in = asked.iter().find(|(path, found)| {
                let file = found.as_deref().unwrap_or(path).file_name();
                names.iter().any(|name| Some(name.as_os_str()) == file)
            });
            let origin = Origin::Graph(named.text.clone(), named.at.clone());
            let places = finder.places(&named.dir, text);
            let interpreter = named.interpreter.as_deref();
            match stands_in {
                Some((_, Some(found))) => known.add(finder, found, interpreter, origin),
                Some((_, None)) => {}
                None => match find(text, &places) {
                    Some(found) => match finder.permits(&found) {
                        // An interpreter is a program, too: the user's is taken.
                        Ok(finder) if finder.only.is_none() => known.add(&finder, &found, interpreter, origin),
                        Ok(finder) => {
                            known.add(&finder, &found, None, origin);
                            known.name_interpreter(&found, interpreter);
                        }
                        Err(why) => {
                            known.refused.push(Refused { path: found, why, origin, note: None, help: None });
                        }
                    },
                    None => known.refused.push(finder.not_found(text, &places, origin)),
                },
            }
        }
        for library in finder.folders.iter().flat_map(|folder| libraries(folder)) {
            known.add(finder, &library, None, Origin::Folder);
        }
        known.name_carried(finder);
        #[cfg(unix)]
        known.launch_by(finder, &self.registry);
        known
    }

    /// The files of plugins named explicitly, and the paths at which missing ones are searched.
    pub(crate) fn files(&self, named: &[NamedPlugin]) -> Vec<PathBuf> {
        let Some(finder) = &self.finder else { return Vec::new() };
        let candidates = |dir: &Path, path: &Path| -> Vec<PathBuf> {
            let places = finder.places(dir, path);
            places.iter().flat_map(|place| names(path).into_iter().map(|name| place.join(name))).collect()
        };
        let mut files: Vec<_> = finder.asked.iter().flat_map(|path| candidates(Path::new(""), path)).collect();
        files.extend(named.iter().flat_map(|named| candidates(&named.dir, Path::new(&named.text))));
        let loaded = self.with(named).plugins;
        files.extend(loaded.iter().flat_map(|plugin| &plugin.description.loads.files).map(|file| file.path.clone()));
        files.extend(finder.folders.iter().flat_map(|folder| libraries(folder)));
        files
    }
}

impl Scripts {
    fn command(&self, what: &str, file: Option<&Path>) -> Launcher {
        let mut command = self.interpreter.clone();
        command.arguments.push(what.into());
        command.arguments.extend(file.map(|file| file.as_os_str().into()));
        command
    }
}

/// Where a file that a recorded plugin loaded may be now: beside the file that is found, or where it was.
fn places(plugin: &PlanPlugin, file: &LoadedFile, found: &Path) -> impl Iterator<Item = PathBuf> {
    let folder = |path: &Path| path.parent().unwrap_or(Path::new("")).to_owned();
    let beside = file.path.strip_prefix(folder(&plugin.path)).map(|name| folder(&absolute(found)).join(name));
    [beside.ok(), Some(file.path.clone())].into_iter().flatten()
}

/// The first module or library that a recorded plugin loaded and that is another beside the file that is found now, or where it was.
fn changed_beside(plugin: &PlanPlugin, found: &Path) -> Option<PathBuf> {
    let place = |file: &LoadedFile| places(plugin, file, found).find(|place| place.is_file());
    let files = plugin.loads.files.iter().filter_map(|file| Some((place(file)?, &file.sha256)));
    let mut changed = files.filter(|(place, then)| sha256(place).is_ok_and(|(_, now)| now.to_string() != **then));
    changed.next().map(|(place, _)| place)
}

/// Names the modules and libraries that a script of a recording may load from its own folder and the current one, as a list in JSON.
const RECORDED_MODULES: &str = "OSTEOFLOW_RECORDED_MODULES";

impl Finder {
    /// The finder by which a file that a graph names may be loaded. That of a script which a recorded run had loaded finds, in the folder of
    /// the script and the current one, only the modules that the run had loaded.
    ///
    /// # Errors
    /// Why the file may not be loaded.
    fn permits(&self, path: &Path) -> Result<Cow<'_, Self>, String> {
        let Some(only) = &self.only else { return Ok(Cow::Borrowed(self)) };
        let found = sha256(path).map_err(|error| format!("it cannot be read: {error}"))?.1.to_string();
        if !only.contains(&found) {
            return Err(format!(
                "its SHA-256 is {found}, not that of the recorded run, and a file that a recording names is not loaded \
                 without that; if you trust it, name it yourself: --plugin {}",
                path.display()
            ));
        }
        let recorded: Vec<_> = self.recorded.iter().filter(|plugin| plugin.sha256 == found).collect();
        if let Some(file) = recorded.iter().find_map(|plugin| changed_beside(plugin, path)) {
            return Err(format!(
                "{}, which it loads, is not as in the recorded run, and what a recording names is not run without that; if you trust it, \
                 name the plugin yourself: --plugin {}",
                file.display(),
                path.display()
            ));
        }
        if recorded.is_empty() {
            return Ok(Cow::Borrowed(self));
        }
        let mut finder = self.clone();
        if let Some(scripts) = &mut finder.scripts {
            let loads = recorded.iter().flat_map(|plugin| plugin.loads.files.iter().map(move |file| (plugin, file)));
            let modules: Vec<_> = loads.flat_map(|(plugin, file)| places(plugin, file, path)).collect();
            scripts.interpreter.environment.push((RECORDED_MODULES, serde_json::json!(modules).to_string()));
        }
        Ok(Cow::Owned(finder))
    }

    /// The folders in which a path is searched.
    fn places(&self, dir: &Path, path: &Path) -> Vec<PathBuf> {
        let parent = path.parent().unwrap_or(Path::new(""));
        let mut places = vec![dir.join(parent)];
        if parent == Path::new("") {
            places.extend(self.folders.iter().cloned());
        }
        places
    }

    fn not_found(&self, path: &Path, places: &[PathBuf], origin: Origin) -> Refused {
        let names: Vec<_> = names(path).iter().map(|name| name.display().to_string()).collect();
        let places: Vec<_> = places
            .iter()
            .map(|place| if place == Path::new("") { ".".into() } else { place.display().to_string() })
            .collect();
        let note = format!("looked for {} in {}", names.join(", "), places.join(", "));
        let help = places.first().and_then(|place| nearest::file(&Path::new(place).join(path.file_name()?)));
        Refused { path: path.into(), why: "there is no such file".into(), origin, note: Some(note), help }
    }

    /// The plugin at `path`, as it was when it was looked at first if plugins are held.
    fn look_at(&self, path: &Path, interpreter: Option<&Path>) -> Result<Plugin, String> {
        let Some(held) = &self.held else { return self.look(path, interpreter) };
        let mut plugins = held.plugins.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(plugin) = plugins.get(path) {
            return Ok(plugin.clone());
        }
        let mut plugin = self.look(path, interpreter)?;
        let to = held.folder.path().join(plugins.len().to_string());
        let copy = copies::copy(&plugin, &to).map_err(|error| format!("it cannot be copied: {error}"))?;
        if let Some(script) = &mut plugin.script {
            script.arguments.push(copy.clone().into());
        }
        plugin.copy = Some(copy);
        plugins.insert(path.into(), plugin.clone());
        Ok(plugin)
    }

    /// Looks at a plugin anew next time, whatever the stamps of its files say.
    #[cfg(unix)]
    pub(super) fn forget(&self, plugin: &Plugin) {
        let interpreter = plugin.script.as_ref().map(|script| &*script.program);
        let key = fs::metadata(&plugin.path).ok().and_then(|file| {
            let digest = self.sha256(&plugin.path, &stamp(&file)).ok()?;
            self.key(&plugin.path, &stamp(&file), digest, self.script(&plugin.path, interpreter).as_ref())
        });
        if let (Some(store), Some(key)) = (&self.store, key) {
            // What is no description is read again.
            let _ = store.put(&key, &[b"forgotten"]);
        }
    }

    /// Reads the description of the library at `path`: from the cache, or by another process.
    fn look(&self, path: &Path, interpreter: Option<&Path>) -> Result<Plugin, String> {
        let script = self.script(path, interpreter);
        if let (Some(_), Some(why)) = (&script, REFUSED_HERE) {
            return Err(format!("a plugin in Python has no other place than a process of its own, and {why}"));
        }
        let unread = |error: io::Error| format!("it cannot be read: {error}");
        // The file may be rebuilt while it is read.
        for _ in 0..3 {
            let before = stamp(&fs::metadata(path).map_err(unread)?);
            let digest = self.sha256(path, &before).map_err(unread)?;
            let key = self.key(path, &before, digest, script.as_ref());
            let kept = key.as_ref().and_then(|key| self.store.as_ref()?.get(key));
            let kept = kept.and_then(|entry| serde_json::from_slice::<Look>(entry.bytes()).ok());
            let kept = kept.filter(Look::is_current);
            let is_kept = kept.is_some();
            let look = match kept {
                Some(look) => Ok(look),
                None => probe::probe(&self.prober(script.as_ref()), path)
                    .map_err(|error| error.to_string())
                    .map(|description| Look { stamps: Look::stamps(&description), description }),
            };
            if stamp(&fs::metadata(path).map_err(unread)?) != before {
                continue;
            }
            let look = look?;
            let is_as_told =
                |file: &LoadedFile| sha256(&file.path).is_ok_and(|(_, digest)| digest.to_string() == file.sha256);
            if !is_kept && !look.description.loads.files.iter().all(is_as_told) {
                continue;
            }
            if let (Some(key), Some(store)) = (&key, &self.store)
                && !is_kept
                && let Ok(json) = serde_json::to_vec(&look)
            {
                // If the description cannot be cached, it is read again next time.
                let _ = store.put(key, &[&json]);
            }
            let names_interpreter = script.is_some() && interpreter.is_some();
            let script = script.map(|scripts| scripts.command("serve", Some(path)));
            let (path, sha256, description) = (path.into(), Arc::<str>::from(digest.to_string()), look.description);
            let identity = match description.loads.is_empty() {
                true => sha256.clone(),
                false => {
                    let key = Key::of("plugin").digest("file", digest).text("loads", &description.loads.identity());
                    key.done().digest().to_string().into()
                }
            };
            let (copy, named) = (None, false);
            return Ok(Plugin { path, sha256, identity, copy, description, named, script, names_interpreter });
        }
        Err("it changes while it is looked at; is it being built?".into())
    }

    /// What runs the file, if it is a script.
    fn script(&self, path: &Path, interpreter: Option<&Path>) -> Option<Scripts> {
        let is_script = |scripts: &&Scripts| path.extension().is_some_and(|ending| ending == scripts.ending);
        let mut scripts = self.scripts.as_ref().filter(is_script)?.clone();
        if let Some(interpreter) = interpreter {
            scripts.interpreter.program = interpreter.into();
        }
        Some(scripts)
    }

    fn prober(&self, script: Option<&Scripts>) -> Prober {
        let Some(scripts) = script else { return self.prober.clone() };
        Prober { launcher: scripts.command("describe", None), timeout: self.prober.timeout }
    }

    fn key(&self, path: &Path, stamp: &str, digest: Digest, script: Option<&Scripts>) -> Option<Key> {
        let key = Key::of("plugin_probe").text("path", &path.to_string_lossy()).text("stamp", stamp);
        let key = key.digest("file", digest).digest("program", self.store.as_ref()?.program()?);
        let interpreter = script.map(|scripts| {
            let limit = |name: &str| format!("{name}={:?}", std::env::var_os(name));
            let program = scripts.interpreter.program.to_string_lossy();
            format!("{program} {:?} {:?}", scripts.interpreter.environment, THREAD_LIMITS.map(limit))
        });
        let key = key.text("interpreter", &interpreter.unwrap_or_default());
        // What the dynamic linker and the interpreter read decides what is loaded.
        let is_read = |name: &str| ["LD_", "DYLD_", "PYTHON"].iter().any(|start| name.starts_with(start));
        let variables: BTreeSet<_> = std::env::vars_os().filter(|(name, _)| is_read(&name.to_string_lossy())).collect();
        let key = key.text("variables", &format!("{variables:?}"));
        Some(key.number("abi", u64::from(abi::MAJOR) << 32 | u64::from(abi::MINOR)).done())
    }

    fn sha256(&self, path: &Path, stamp: &str) -> io::Result<Digest> {
        let Some(store) = &self.store else { return Ok(sha256(path)?.1) };
        let key = Key::of("file_hash").text("path", &path.to_string_lossy()).text("stamp", stamp).done();
        if let Some(kept) = store.get(&key).and_then(|entry| entry.bytes().try_into().ok()) {
            return Ok(Digest(kept));
        }
        let (_, digest) = sha256(path)?;
        let _ = store.put(&key, &[&digest.0]);
        Ok(digest)
    }
}

impl Known {
    /// Adds to the refusal of a script which interpreter the recording names, and how the user names it.
    fn name_interpreter(&mut self, script: &Path, interpreter: Option<&Path>) {
        let refused = self.refused.iter_mut().find(|refused| refused.path == *script);
        if let Some((refused, interpreter)) = refused.zip(interpreter) {
            let interpreter = interpreter.display();
            refused.help = Some(format!(
                "the recording names the interpreter {interpreter}, which is not started without the user; if you trust \
                 it, add --python {interpreter}"
            ));
        }
    }

    /// Adds to the refusal of a plugin that the recording carries its text.
    fn name_carried(&mut self, finder: &Finder) {
        for refused in self.refused.iter_mut().filter(|refused| finder.carried.contains(&refused.path)) {
            let help = "the recording carries its text; if you trust it, add --allow-plugins to run that";
            refused.help = Some(refused.help.take().map_or_else(|| help.into(), |other| format!("{other}; {help}")));
        }
    }

    /// Lets nodes fire in processes of their own.
    #[cfg(unix)]
    fn launch_by(&mut self, finder: &Arc<Finder>, own: &Registry) {
        let types: Vec<&'static PayloadType> = self.registry.payload_types().collect();
        self.registry.set_launcher(Arc::new(super::apart::Processes {
            finder: finder.clone(),
            plugins: self.plugins.clone(),
            payloads: types.iter().copied().filter(|ty| own.payload_type(ty.name).is_none()).collect(),
            types: types.into(),
            idle: Arc::default(),
        }));
    }

    fn add(&mut self, finder: &Finder, path: &Path, interpreter: Option<&Path>, origin: Origin) {
        let named = matches!(origin, Origin::Graph(..));
        let path = &absolute(path);
        if self.refused.iter().any(|refused| refused.path == *path) {
            return;
        }
        if let Some(known) = self.plugins.iter_mut().find(|plugin| plugin.path == *path) {
            Arc::make_mut(known).named |= named;
            return;
        }
        match finder.look_at(path, interpreter).and_then(|plugin| self.provide(Plugin { named, ..plugin })) {
            Ok(()) => {}
            Err(why) => self.refused.push(Refused { path: path.clone(), why, origin, note: None, help: None }),
        }
    }

    /// Adds all kinds and payloads of a plugin, or none.
    fn provide(&mut self, plugin: Plugin) -> Result<(), String> {
        if let Some(same) = self.plugins.iter_mut().find(|other| other.sha256 == plugin.sha256) {
            // The same library named twice is one plugin.
            Arc::make_mut(same).named |= plugin.named;
            return Ok(());
        }
        let plugin = Arc::new(plugin);
        let (mut registry, loaded) = (self.registry.clone(), plugin.clone());
        let provided = provide(&mut registry, &plugin.description, &plugin.identity, move || load::load(&loaded));
        provided.map_err(|error| match error {
            ProvideError::Kind(clash) => match self.of_kind(clash.0) {
                Some(other) => format!("{clash}, of plugin {} ({})", other.description.name, other.path.display()),
                None => format!("{clash}, of the program itself"),
            },
            other => other.to_string(),
        })?;
        self.registry = registry;
        self.plugins.push(plugin);
        Ok(())
    }

    /// The plugin that provides a kind.
    pub fn of_kind(&self, kind: &str) -> Option<&Plugin> {
        let identity = self.registry.kind(kind)?.plugin.as_ref()?;
        self.plugins.iter().find(|plugin| plugin.identity == *identity).map(|plugin| &**plugin)
    }

    /// The refused libraries as faults; those merely found in a folder are warnings.
    pub fn faults(&self) -> Vec<Fault> {
        self.refused.iter().map(Refused::fault).collect()
    }
}

impl Refused {
    fn of(named: &NamedPlugin, why: String) -> Self {
        let origin = Origin::Graph(named.text.clone(), named.at.clone());
        Self { path: named.dir.join(&named.text), why, origin, note: None, help: None }
    }

    /// Whether it was named explicitly.
    pub fn is_asked(&self) -> bool {
        !matches!(self.origin, Origin::Folder)
    }

    fn fault(&self) -> Fault {
        let fault = match &self.origin {
            Origin::Graph(text, at) => {
                let fault = Fault::new(format!("plugin \"{text}\" is refused: {}", self.why));
                match at {
                    Some(at) => fault.at(at, "no plugin"),
                    None => fault,
                }
            }
            Origin::Asked => Fault::new(format!("plugin {} is refused: {}", self.path.display(), self.why)),
            Origin::Folder => Fault::new(format!("plugin {} is left out: {}", self.path.display(), self.why)).warning(),
        };
        fault.note_if(self.note.clone()).help_if(self.help.clone())
    }
}

/// The file names for a plugin's name: `lib` and `.so` may be left out.
fn names(path: &Path) -> Vec<PathBuf> {
    let Some(name) = path.file_name().map(|name| name.to_string_lossy().into_owned()) else { return Vec::new() };
    let is_library = path.extension().is_some_and(|e| ["so", "dylib", "dll", "py"].iter().any(|library| e == *library))
        || name.contains(".so.");
    let mut names = vec![PathBuf::from(&name)];
    if !is_library {
        names.push(format!("{DLL_PREFIX}{name}{DLL_SUFFIX}").into());
        names.push(format!("{name}{DLL_SUFFIX}").into());
    }
    let mut seen = BTreeSet::new();
    names.retain(|name| seen.insert(name.clone()));
    names
}

fn find(path: &Path, places: &[PathBuf]) -> Option<PathBuf> {
    let names = names(path);
    let mut candidates = places.iter().flat_map(|place| names.iter().map(move |name| place.join(name)));
    candidates.find(|file| file.is_file()).map(|file| absolute(&file))
}

/// The path with links among its folders resolved; the file keeps its name.
fn absolute(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let dir = path.parent().and_then(|dir| dir.canonicalize().ok());
    match (dir, path.file_name()) {
        (Some(dir), Some(name)) => dir.join(name),
        _ => path,
    }
}

/// The libraries of a folder, sorted by name; none if it cannot be read.
fn libraries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.map(|entry| entry.path()).collect();
    files.retain(|file| {
        file.extension().is_some_and(|e| e == DLL_EXTENSION) && file.is_file() && File::open(file).is_ok()
    });
    files.sort();
    files
}
