//! Writes an archive.

use super::{
    GRAPH, INDEX, README, REQUIREMENTS, RESULTS,
    index::{Entry, FORMAT, Index, Role, What},
    renamed::{Renamed, changed, is_path_key, plain, set_changed},
    ro_crate,
    search::{Search, has_content},
};
use crate::app::{error::UsageError, files::check_new, program::registry, sweep::folder_error};
use anyhow::{Context, Result, anyhow};
use clap::Args;
use osteoflow_engine::{
    check,
    durable::Part,
    hash::{Digest, copy_hashed, sha256},
    plan::PlanPlugin,
    recover::copy_renamed,
    regular,
    run::files,
    sweep::{self, Folder},
    temporary,
};
use serde_json::Value as Json;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};
use zip::{CompressionMethod, DateTime, ZipWriter, write::SimpleFileOptions};

/// Larger files need 64-bit sizes in the archive.
const LARGE: u64 = 1 << 31;

/// What may be in the folder and is made from the rest, or holds paths of the machine.
const OTHERS: [&str; 4] =
    [osteoflow_report::PAGE, osteoflow_report::FIGURES, osteoflow_report::BIBLIOGRAPHY, files::REPRO];

/// An archive to write.
#[derive(Debug, Clone, Args)]
pub struct ExportRequest {
    /// The folder of a sweep or of a run.
    #[arg(value_name = "DIR")]
    pub from: PathBuf,

    /// The archive to write, a zip; nothing is overwritten.
    #[arg(value_name = "OUT.zip")]
    pub to: PathBuf,

    /// Leave out the input files; their names, sizes and SHA-256 are listed, and whoever runs it again has them by --data DIR.
    #[arg(long)]
    pub no_data: bool,

    /// A folder in which input files that are no longer where they were are found by their contents; may be given again.
    #[arg(long, value_name = "DIR")]
    pub data: Vec<PathBuf>,

    /// The licence of the archive, a URL or a text, for its ro-crate-metadata.json.
    #[arg(long, value_name = "LICENCE")]
    pub licence: Option<String>,
}

/// A written archive.
#[derive(Debug, Clone)]
pub struct Exported {
    /// Size of the archive.
    pub bytes: u64,
    /// Number of files in it.
    pub n_files: usize,
    /// Input files that are left out.
    pub n_without: usize,
    /// What the reader of the archive should know.
    pub notes: Vec<String>,
}

/// Where the bytes of a file come from.
enum Source {
    Bytes(Vec<u8>),
    File(PathBuf),
    /// With the size and SHA-256 that it was found to have.
    Known(PathBuf, u64, String),
    /// Left out: size and SHA-256.
    Absent(u64, String),
}

impl Source {
    /// What the list of files says of it.
    fn entry(&self, path: &str, role: Role) -> Result<Entry> {
        let (bytes, sha256, included) = match self {
            Self::Bytes(bytes) => (bytes.len() as u64, Digest::of(bytes).to_string(), true),
            Self::File(file) => {
                let found = sha256(file).with_context(|| format!("{} cannot be read", file.display()))?;
                (found.0, found.1.to_string(), true)
            }
            Self::Known(_, bytes, digest) => (*bytes, digest.clone(), true),
            Self::Absent(bytes, digest) => (*bytes, digest.clone(), false),
        };
        Ok(Entry { path: path.into(), role, bytes, sha256, included })
    }
}

/// An archive under way.
struct Pack {
    what: What,
    /// `sweep.json` or `manifest.json`.
    about: Json,
    dir: PathBuf,
    /// The folder that the run began in, absolute.
    began_in: PathBuf,
    /// The graph, absolute.
    graph_file: PathBuf,
    renamed: Renamed,
    files: BTreeMap<String, (Role, Source)>,
    notes: Vec<String>,
    /// Holds changed copies of recordings.
    temporary: tempfile::TempDir,
}

impl ExportRequest {
    /// Writes the archive. `progress` is called with the bytes so far and all bytes.
    ///
    /// # Errors
    /// The folder is not that of a run or a sweep, the archive exists, or an input or a plugin is not as it was.
    pub fn export(&self, progress: &mut dyn FnMut(u64, u64)) -> Result<Exported> {
        check_new(&self.to)?;
        let mut pack = Pack::open(&self.from)?;
        let graph = pack.graph()?;
        pack.inputs(&graph, self)?;
        pack.plugins()?;
        pack.sources();
        pack.results()?;
        pack.add(GRAPH, Role::Graph, Source::Bytes(pack.renamed.graph(&graph).into_bytes()));
        let index = pack.describe(self.licence.as_deref())?;
        let n_without = index.files.iter().filter(|entry| !entry.included).count();
        let bytes = pack.write(&index, &self.to, progress)?;
        Ok(Exported { bytes, n_files: index.files.len() - n_without + 1, n_without, notes: pack.notes })
    }
}

impl Pack {
    fn open(dir: &Path) -> Result<Self> {
        let (what, about) = if dir.join(sweep::DESIGN).is_file() {
            let folder = Folder::open(dir).map_err(folder_error)?;
            let is_whole = folder.runs().map_err(folder_error)?.len() >= folder.n_runs();
            if let Some(shard) = folder.about["shard"].as_str().filter(|_| !is_whole) {
                let dir = dir.display();
                usage!(
                    "{dir} is part {shard} of a sweep; combine the parts by `osteoflow sweep --merge`, and export that"
                );
            }
            (What::Sweep, folder.about)
        } else {
            let path = dir.join(files::MANIFEST);
            let message = || {
                let (dir, manifest, design) = (dir.display(), files::MANIFEST, sweep::DESIGN);
                UsageError(format!(
                    "{dir} is not the folder of a run ({manifest} is missing) or of a sweep ({design} is missing)"
                ))
            };
            let text = regular(&path).and_then(fs::read).map_err(|_| message())?;
            (What::Run, serde_json::from_slice(&text).with_context(|| format!("{} is no JSON", path.display()))?)
        };
        for (key, why) in
            [("given_wires", "inputs that a program gave it in memory"), ("given_nodes", "functions of a notebook")]
        {
            if about["command"][key].as_array().is_some_and(|given| !given.is_empty()) {
                usage!(
                    "{}: the run had {why} ({}), which no file holds; save them to files, and run it again",
                    dir.display(),
                    about["command"][key]
                );
            }
        }
        let graph_file = Path::new(about["graph"]["file"].as_str().unwrap_or_default());
        let began_in = began_in(dir, graph_file);
        let graph_file = plain(&began_in.join(graph_file));
        let renamed = Renamed::of(graph_file.parent().unwrap_or(Path::new("")));
        let temporary = temporary::folder("export").context("no temporary folder")?;
        Ok(Self {
            what,
            about,
            dir: dir.into(),
            began_in,
            graph_file,
            renamed,
            files: BTreeMap::new(),
            notes: Vec::new(),
            temporary,
        })
    }

    fn add(&mut self, path: &str, role: Role, source: Source) {
        self.files.insert(path.into(), (role, source));
    }

    /// The graph as it ran.
    fn graph(&self) -> Result<String> {
        match self.what {
            What::Sweep => {
                Ok(Folder::open(&self.dir).and_then(|folder| folder.graph_of_rows()).map_err(folder_error)?)
            }
            What::Run => {
                let graph = self.about["resolved_graph"].as_str();
                Ok(graph
                    .ok_or_else(|| anyhow!("{} has no resolved_graph", self.dir.join(files::MANIFEST).display()))?
                    .into())
            }
        }
    }

    /// Names every input file, and finds it by its contents.
    fn inputs(&mut self, graph: &str, request: &ExportRequest) -> Result<()> {
        let mut inputs: Vec<(PathBuf, u64, String)> = Vec::new();
        for entry in self.about["inputs"].as_array().into_iter().flatten() {
            let path = self.renamed.resolved(entry["path"].as_str().unwrap_or_default());
            let (Some(bytes), Some(digest)) = (entry["bytes"].as_u64(), entry["sha256"].as_str()) else {
                let path = path.display();
                usage!("input {path} was not read: {}", entry["error"]);
            };
            if let Some((_, _, other)) = inputs.iter().find(|(known, ..)| *known == path)
                && other != digest
            {
                let path = path.display();
                usage!("two inputs of the run are called {path}; give them other names, and run it again");
            }
            inputs.push((path, bytes, digest.into()));
        }
        let mut parents = Vec::new();
        let mut name_in = |path: &Path| {
            let parent = path.parent().unwrap_or(Path::new("/")).to_owned();
            let at = parents.iter().position(|known| *known == parent).unwrap_or_else(|| {
                parents.push(parent);
                parents.len() - 1
            });
            format!("inputs/{}/{}", at + 1, path.file_name().unwrap_or_default().to_string_lossy())
        };
        let named = self.named_paths(graph, &inputs);
        // A file within a named folder stays there: the folder may be read as a whole.
        let is_within = |path: &&PathBuf| named.iter().any(|folder| *path != folder && path.starts_with(folder));
        for path in named.iter().filter(|path| !is_within(path)) {
            self.renamed.add(path, &name_in(path));
        }
        for path in named.iter().filter(is_within) {
            if let Some(name) = self.renamed.name_below(path) {
                self.renamed.add(path, &name);
            }
        }
        let search = Search::below(&request.data)?;
        let mut missing = Vec::new();
        for (path, bytes, digest) in inputs {
            let name = self.renamed.name_below(&path).unwrap_or_else(|| name_in(&path));
            self.renamed.add(&path, &name);
            let source = if request.no_data {
                Source::Absent(bytes, digest)
            } else if has_content(&path, bytes, &digest) {
                Source::Known(path, bytes, digest)
            } else if let Some(found) = search.find(bytes, &digest) {
                Source::Known(found, bytes, digest)
            } else {
                missing.push(format!("{} ({bytes} bytes, SHA-256 {digest})", path.display()));
                continue;
            };
            self.add(&name, Role::Input, source);
        }
        if !missing.is_empty() {
            usage!(
                "{} input files are not what the {} read: {}; name a folder that holds them by --data DIR, or leave inputs out by --no-data",
                missing.len(),
                self.what.name(),
                missing.join(", ")
            );
        }
        Ok(())
    }

    /// The paths in the graph and its settings that lead to inputs, or to folders of inputs.
    fn named_paths(&self, graph: &str, inputs: &[(PathBuf, u64, String)]) -> Vec<PathBuf> {
        let mut named = Vec::new();
        let mut collect = |key: &str, text: &str| {
            let path = self.renamed.resolved(text);
            let is_file = inputs.iter().any(|(input, ..)| *input == path);
            let may_be_folder = Path::new(text).is_absolute() || is_path_key(key);
            if is_file || may_be_folder && inputs.iter().any(|(input, ..)| input.starts_with(&path)) {
                named.push(path);
            }
            None
        };
        let _ = changed(graph, &mut collect);
        let sets = self.about["sweep"]["factors"].as_array().into_iter().flatten();
        let sets = sets.flat_map(|factor| factor["levels"].as_array().into_iter().flatten());
        for set in sets.flat_map(|level| level["sets"].as_array().into_iter().flatten()).filter_map(Json::as_str) {
            let _ = set_changed(set, &mut collect);
        }
        named
    }

    /// Plugins, with the modules and libraries beside them.
    fn plugins(&mut self) -> Result<()> {
        let plugins: Vec<PlanPlugin> = serde_json::from_value(self.about["plugins"].clone()).unwrap_or_default();
        let mut packages = BTreeSet::new();
        let mut environment = BTreeSet::new();
        for (number, plugin) in plugins.iter().enumerate() {
            let root = format!("plugins/{}", number + 1);
            let name = format!("{root}/{}", base_name(&plugin.path));
            self.code(&name, Role::Plugin, &plugin.path, &plugin.sha256, &plugin.name)?;
            for file in &plugin.loads.files {
                let name = format!("{root}/{}", module_path(&file.name, &file.path));
                self.code(&name, Role::Module, &file.path, &file.sha256, &plugin.name)?;
            }
            if let Some(interpreter) = &plugin.interpreter {
                self.renamed.add_text(interpreter.to_string_lossy().into_owned(), "python3".into());
            }
            packages.extend(plugin.loads.packages.iter().map(|package| package.replacen(' ', "==", 1)));
            environment.extend(plugin.loads.environment.iter().cloned());
        }
        if !packages.is_empty() || !environment.is_empty() {
            let about = environment.iter().map(|entry| format!("# {entry}\n"));
            let text: String = about.chain(packages.iter().map(|package| format!("{package}\n"))).collect();
            self.add(REQUIREMENTS, Role::About, Source::Bytes(text.into_bytes()));
        }
        Ok(())
    }

    fn code(&mut self, name: &str, role: Role, path: &Path, digest: &str, plugin: &str) -> Result<()> {
        let bytes = fs::metadata(path).map_or(0, |about| about.len());
        if !has_content(path, bytes, digest) {
            usage!(
                "{} of plugin {plugin} is no longer what the {} ran (SHA-256 {digest}); restore it, or run again",
                path.display(),
                self.what.name()
            );
        }
        if let Some((_, Source::Known(other, _, of_other))) = self.files.get(name)
            && of_other != digest
        {
            usage!("{} and {} would have one name in the archive", other.display(), path.display());
        }
        self.renamed.add(path, name);
        self.add(name, role, Source::Known(path.into(), bytes, digest.into()));
        Ok(())
    }

    /// The files that the graph was written in, as far as they are still there.
    fn sources(&mut self) {
        let dir = self.graph_file.parent().unwrap_or(Path::new("")).to_owned();
        for place in [&dir, &self.began_in] {
            if place.parent().is_some() {
                self.renamed.add_text(format!("{}/", place.display()), String::new());
            }
        }
        let mut texts = Vec::new();
        for path in check::files(&self.graph_file, &[], &registry()).iter().map(|path| plain(path)) {
            let Ok(text) = regular(&path).and_then(fs::read_to_string) else { continue };
            if path.extension().is_none_or(|end| end != "toml") {
                continue;
            }
            let below = path.strip_prefix(&dir).map_or_else(|_| base_name(&path), |below| below.display().to_string());
            let name = format!("sources/{below}");
            self.renamed.add(&path, &name);
            texts.push((name, text));
        }
        for (name, text) in texts {
            let text = self.renamed.text(&text);
            self.files.entry(name).or_insert((Role::Source, Source::Bytes(text.into_bytes())));
        }
    }

    /// What the run or the sweep has left, without its report.
    fn results(&mut self) -> Result<()> {
        let mut paths = Vec::new();
        list(&self.dir, Path::new(""), &mut paths)?;
        for below in paths {
            let path = self.dir.join(&below);
            let name = format!("{RESULTS}/{}", below.display());
            let source = match path.extension().and_then(|end| end.to_str()) {
                Some("json" | "csv" | "toml") => self.text_of(&path)?,
                _ if below == Path::new(files::RECORDING) => self.recording(&path)?,
                _ => Source::File(path),
            };
            self.add(&name, Role::Result, source);
        }
        if self.what == What::Sweep {
            let folder = Folder::open(&self.dir).map_err(folder_error)?;
            let (n, all) = (folder.runs().map_err(folder_error)?.len(), folder.n_runs());
            if n < all {
                self.notes.push(format!("the sweep is not finished: {n} of {all} runs are there"));
            }
        }
        Ok(())
    }

    /// A text without paths of the machine; the file as it is where there are none.
    fn text_of(&self, path: &Path) -> Result<Source> {
        let bytes = regular(path).and_then(fs::read).with_context(|| format!("{} cannot be read", path.display()))?;
        let Ok(text) = std::str::from_utf8(&bytes) else { return Ok(Source::File(path.into())) };
        let renamed = self.renamed_text(text);
        Ok(if renamed == text { Source::File(path.into()) } else { Source::Bytes(renamed.into_bytes()) })
    }

    fn renamed_text(&self, text: &str) -> String {
        if let Ok(json) = serde_json::from_str::<Json>(text)
            && (json.is_object() || json.is_array())
        {
            let mut renamed = json.clone();
            self.renamed.json(&mut renamed);
            let is_pretty = text.starts_with("{\n") || text.starts_with("[\n");
            let end = if text.ends_with('\n') { "\n" } else { "" };
            return match (renamed == json, is_pretty) {
                (true, _) => text.into(),
                (false, true) => format!("{renamed:#}{end}"),
                (false, false) => format!("{renamed}{end}"),
            };
        }
        if text.contains("\n[graph]") || text.starts_with("[graph]") {
            return self.renamed.graph(text);
        }
        self.renamed.text(text)
    }

    /// The recording; a copy where its metadata names paths.
    fn recording(&self, path: &Path) -> Result<Source> {
        let graph = self.about["resolved_graph"].as_str().unwrap_or_default();
        let has_plugins = self.about["plugins"].as_array().is_some_and(|plugins| !plugins.is_empty());
        if self.renamed.graph(graph) == graph && !has_plugins {
            return Ok(Source::File(path.into()));
        }
        let copy = self.temporary.path().join(files::RECORDING);
        copy_renamed(path, &copy, &|text| self.renamed_text(text))?;
        Ok(Source::File(copy))
    }

    /// Adds what describes the archive; the list of all files.
    fn describe(&mut self, licence: Option<&str>) -> Result<Index> {
        let name = self.about["graph"]["name"].as_str().unwrap_or("graph").to_owned();
        let readme = readme(
            self.what,
            &name,
            self.files.values().map(|(role, source)| (*role, matches!(source, Source::Absent(..)))),
        );
        self.add(README, Role::About, Source::Bytes(readme.into_bytes()));
        let version = env!("CARGO_PKG_VERSION").into();
        let mut index = Index { format: FORMAT, version, what: self.what, name, files: Vec::new() };
        for (path, (role, source)) in &self.files {
            index.files.push(source.entry(path, *role)?);
        }
        let ended = match self.what {
            What::Run => self.about["ended"].as_str().map(str::to_owned),
            What::Sweep => {
                fs::metadata(self.dir.join(sweep::DESIGN)).and_then(|about| about.modified()).ok().and_then(|time| {
                    Some(jiff::Timestamp::try_from(time).ok()?.strftime("%Y-%m-%dT%H:%M:%SZ").to_string())
                })
            }
        };
        let ended = ended.unwrap_or_else(|| "1980-01-01T00:00:00Z".into());
        let mut about = self.about.clone();
        self.renamed.json(&mut about);
        let text = format!("{:#}\n", ro_crate::metadata(&index, &about, &ended, licence));
        let metadata = Source::Bytes(text.into_bytes());
        index.files.push(metadata.entry(ro_crate::FILE, Role::About)?);
        self.add(ro_crate::FILE, Role::About, metadata);
        index.files.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(index)
    }

    /// Writes the archive beside its name, then gives it its name. The same files give the same bytes.
    fn write(&self, index: &Index, to: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<u64> {
        let cannot = || format!("{} cannot be written", to.display());
        let mut part = Part::new(to).with_context(cannot)?;
        let all = index.files.iter().filter(|entry| entry.included).map(|entry| entry.bytes).sum();
        let mut done = 0;
        let mut zip = ZipWriter::new(part.file());
        let list = format!("{}\n", serde_json::to_string_pretty(index)?);
        let options = |bytes: u64| {
            let options = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
            options.last_modified_time(DateTime::default()).unix_permissions(0o644).large_file(bytes >= LARGE)
        };
        zip.start_file(INDEX, options(list.len() as u64)).with_context(cannot)?;
        zip.write_all(list.as_bytes()).with_context(cannot)?;
        for entry in index.files.iter().filter(|entry| entry.included) {
            zip.start_file(&*entry.path, options(entry.bytes)).with_context(cannot)?;
            match &self.files[&entry.path].1 {
                Source::Bytes(bytes) => zip.write_all(bytes).with_context(cannot)?,
                Source::File(path) | Source::Known(path, ..) => {
                    let from = regular(path)
                        .and_then(fs::File::open)
                        .with_context(|| format!("{} cannot be read", path.display()))?;
                    let mut to = Counted { to: &mut zip, n: done, progress: &mut |n| progress(n, all) };
                    let (bytes, digest) = copy_hashed(from, &mut to).with_context(cannot)?;
                    if (bytes, digest.to_string()) != (entry.bytes, entry.sha256.clone()) {
                        return Err(anyhow!("{} has changed while it was read; nothing was written", path.display()));
                    }
                }
                Source::Absent(..) => {}
            }
            done += entry.bytes;
            progress(done, all);
        }
        zip.finish().with_context(cannot)?;
        let bytes = part.file().metadata().with_context(cannot)?.len();
        part.keep_new().with_context(cannot)?;
        Ok(bytes)
    }
}

/// Tells how much has been written.
struct Counted<'a> {
    to: &'a mut dyn Write,
    n: u64,
    progress: &'a mut dyn FnMut(u64),
}

impl Write for Counted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.to.write(bytes)?;
        self.n += n as u64;
        (self.progress)(self.n);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

/// The folder that relative paths of a run begin in: the next above the run's folder that has the graph, or the current one.
fn began_in(dir: &Path, graph_file: &Path) -> PathBuf {
    let (here, dir) = (plain(Path::new("")), plain(dir));
    dir.ancestors().find(|place| place.join(graph_file).is_file()).unwrap_or(&here).into()
}

fn base_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The path of a module below the folder of its plugin, from which it is imported by its name.
fn module_path(name: &str, path: &Path) -> String {
    let file = base_name(path);
    if name == file {
        return file;
    }
    let mut parts: Vec<&str> = name.split('.').collect();
    if path.file_stem().is_none_or(|stem| stem != "__init__") {
        parts.pop();
    }
    parts.push(&file);
    parts.join("/")
}

/// The files of a folder and of those below, sorted by name: no links, no reports, nothing hidden.
fn list(dir: &Path, below: &Path, out: &mut Vec<PathBuf>) -> Result<()> {
    let folder = dir.join(below);
    let entries = fs::read_dir(&folder).with_context(|| format!("{} cannot be read", folder.display()))?;
    let mut entries = entries.collect::<std::io::Result<Vec<_>>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let name = entry.file_name();
        let is_other = OTHERS.iter().any(|other| name == *other) || name.to_string_lossy().starts_with('.');
        match entry.file_type()? {
            _ if is_other && below == Path::new("") => {}
            kind if kind.is_dir() => list(dir, &below.join(name), out)?,
            kind if kind.is_file() => out.push(below.join(name)),
            _ => {}
        }
    }
    Ok(())
}

/// How it is run again.
fn readme(what: What, name: &str, files: impl Iterator<Item = (Role, bool)>) -> String {
    let (mut has_plugins, mut lacks_data) = (false, false);
    for (role, is_absent) in files {
        has_plugins |= role == Role::Plugin;
        lacks_data |= is_absent;
    }
    let command = what.name();
    let plugins = if has_plugins { " --allow-plugins" } else { "" };
    let data = if lacks_data { " --data DIR" } else { "" };
    let mut text = format!(
        "# {name}: a {command} of osteoflow {}\n\nResearch use only, not for clinical use.\n\n\
         ```sh\nosteoflow {command} THIS.zip{plugins}{data} --out again     # runs it again\n\
         osteoflow compare THIS.zip again                # equal, or what differs\n```\n\n\
         | | |\n|---|---|\n\
         | `graph.toml` | the graph as it ran, with every default; paths lead into this archive |\n\
         | `sources/` | the files it was written in |\n\
         | `inputs/` | the files it read, or, where they were left out, nothing |\n\
         | `results/` | what it left: tables, results, provenance, recording |\n\
         | `experiment.json` | every file with size and SHA-256 |\n\
         | `ro-crate-metadata.json` | the same for other programs: a Workflow Run RO-Crate |\n",
        env!("CARGO_PKG_VERSION")
    );
    if has_plugins {
        text += "| `plugins/` | code that the graph loads, with its modules; it runs with your rights, so read it first |\n\
                 | `requirements.lock` | packages of its interpreter: `python3 -m pip install -r requirements.lock` |\n";
    }
    if lacks_data {
        text += "\nThe inputs were left out. `--data DIR` names a folder of yours in which they are found by their contents.\n";
    }
    text
}
