use super::{
    extract::refused,
    limits::MAX_EXTENDS,
    merge::merge,
    parse::parse,
    plugins::{self, NamedPlugin},
    remove::Removed,
    results,
    tree::{Entry, Table, Value},
};
use crate::{
    fault::{Fault, SourceText, Span, Use},
    irregular,
    names::nearest,
};
use serde::{Deserialize, Serialize};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Component, Path, PathBuf},
    sync::{Arc, OnceLock},
};

/// The text of a graph file.
pub(super) fn read(path: &Path) -> Result<String, Box<Fault>> {
    let shown = tidy(path);
    let shown = shown.display();
    if let Some(kind) = irregular(path) {
        return Err(Box::new(Fault::new(format!("{shown} is {kind}; a graph file is needed"))));
    }
    let bytes = fs::read(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => Fault::new(format!("there is no graph file {shown}")).help_if(nearest::file(path)),
        _ if path.is_dir() => Fault::new(format!("{shown} is a folder; a graph file is needed")),
        _ => Fault::new(format!("the graph file {shown} cannot be read: {error}")),
    });
    let bytes = bytes.map_err(Box::new)?;
    let text = String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let fault = Fault::new(format!("the graph file {shown} is no text: byte {at} is not UTF-8"));
        Box::new(fault.help("save it as UTF-8"))
    })?;
    // Editors on Windows may begin a file with a byte order mark.
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// The files that a graph consists of, merged one after the other.
pub(super) struct Chain<'f> {
    /// The files being read, each extending the next: canonical paths, which detect a cycle through links, with the names shown.
    open: Vec<(PathBuf, PathBuf)>,
    /// Canonical paths of all files read so far.
    read: BTreeSet<PathBuf>,
    n_read: usize,
    n_merged: usize,
    /// The extended files, whether or not they could be read.
    pub(super) texts: Vec<PathBuf>,
    /// The plugins named by these files; those of a file follow those of the file it extends.
    pub(super) plugins: Vec<NamedPlugin>,
    /// The order of the first text among all texts of the graph.
    order: usize,
    /// The node that uses the file as a module.
    used: Option<(String, Span)>,
    pub(super) removed: &'f mut Removed,
    pub(super) faults: &'f mut Vec<Fault>,
}

impl<'f> Chain<'f> {
    pub(super) fn new(removed: &'f mut Removed, faults: &'f mut Vec<Fault>) -> Self {
        let (open, read, texts, plugins) = (Vec::new(), BTreeSet::new(), Vec::new(), Vec::new());
        Self { open, read, n_read: 0, n_merged: 0, texts, plugins, order: 0, used: None, removed, faults }
    }

    /// The chain of a module's file.
    pub(super) fn used(self, node: &str, at: &Span, order: usize) -> Self {
        Self { used: Some((node.into(), at.clone())), order, ..self }
    }

    pub(super) fn len(&self) -> usize {
        self.n_read
    }

    /// Loads a graph file with everything it extends.
    pub(super) fn load(&mut self, path: &Path, text: String) -> (Arc<SourceText>, Table) {
        let mut table = Table::default();
        let source = self.load_over(&mut table, path, text);
        (source, table)
    }

    /// Merges a graph file over `base`: the files that it extends in their order, then itself.
    fn load_over(&mut self, base: &mut Table, path: &Path, text: String) -> Arc<SourceText> {
        let source = self.source(path, text);
        self.open.push((canonical(path), source.name.clone()));
        let mut over = parse(&source, self.faults);
        if let Some(entry) = over.remove("extends") {
            self.extended(base, &entry, path);
        }
        self.open.pop();
        self.merge(base, over, &source);
        source
    }

    /// Merges a variant over the graph. What it extends is part of the graph, which [`Variant::read`] has seen to.
    pub(super) fn change(&mut self, base: &mut Table, path: &Path, variant: &Variant) {
        self.texts.push(path.into());
        let source = self.source(path, variant.text.clone());
        let mut over = parse(&source, self.faults);
        over.remove("extends");
        self.merge(base, over, &source);
    }

    fn source(&mut self, path: &Path, text: String) -> Arc<SourceText> {
        let used = self.used.as_ref().map(|(node, at)| Use { node: node.clone(), at: at.clone() });
        let order = self.order + self.n_read;
        self.n_read += 1;
        self.read.insert(canonical(path));
        let dir = std::path::absolute(path).ok().and_then(|p| p.parent().map(Path::to_path_buf)).unwrap_or_default();
        let (name, merged, line_starts) = (tidy(path), OnceLock::new(), OnceLock::new());
        Arc::new(SourceText { name, dir, text, order, command_line: false, merged, used, line_starts })
    }

    fn merge(&mut self, base: &mut Table, mut over: Table, source: &SourceText) {
        let _ = source.merged.set(self.n_merged);
        self.n_merged += 1;
        results::flatten(&mut over, self.faults);
        let named = plugins::take(&mut over, self.faults);
        self.plugins.extend(named);
        self.removed.take_from(base, &mut over, self.faults);
        merge(base, over);
    }

    /// Merges the files that `extends` names over `base`.
    fn extended(&mut self, base: &mut Table, entry: &Entry, path: &Path) {
        for (file, at) in named(entry, path, self.faults) {
            let same = canonical(&file);
            if let Some(start) = self.open.iter().position(|(open, _)| *open == same) {
                let names: Vec<_> = self.open[start..].iter().map(|(_, name)| name.display().to_string()).collect();
                let message = format!("files extend each other in a circle: {} -> {}", names.join(" -> "), names[0]);
                self.faults.push(Fault::new(message).at(at, "closes the circle").hides(at));
                continue;
            }
            if self.read.contains(&same) {
                // Two files of a list may extend the same one, which is below both.
                continue;
            }
            if self.open.len() == MAX_EXTENDS {
                let fault = Fault::new(format!("more than {MAX_EXTENDS} files extend each other"));
                let fault = fault.at(at, "one too many").help("does a program write these files?");
                self.faults.push(fault.hides(at));
                continue;
            }
            self.texts.push(file.clone());
            match read(&file) {
                Ok(text) => drop(self.load_over(base, &file, text)),
                Err(fault) => self.faults.push(fault.at(at, "relative to this file").hides(at)),
            }
        }
    }
}

/// The files that `extends` of the file at `path` names, each once.
fn named<'e>(entry: &'e Entry, path: &Path, faults: &mut Vec<Fault>) -> Vec<(PathBuf, &'e Span)> {
    let items = match &entry.value.value {
        Value::Array(items) => items.as_slice(),
        _ => std::slice::from_ref(&entry.value),
    };
    let (mut files, mut known): (Vec<(PathBuf, &Span)>, BTreeMap<PathBuf, &Span>) = Default::default();
    for item in items {
        let Some(text) = item.as_text() else {
            let fault = refused(item, "extends takes the path of a graph file, or a list of them", "a text is needed");
            faults.push(fault.hides(&item.at));
            continue;
        };
        let file = path.parent().unwrap_or(Path::new("")).join(text);
        let same = canonical(&file);
        match known.get(&same) {
            Some(first) => {
                let fault = Fault::new(format!("extends names {} twice", tidy(&file).display()));
                let fault = fault.at(&item.at, "the second").also(first, "the first").hides(&item.at);
                faults.push(fault.help("take one of them away"));
            }
            None => {
                known.insert(same, &item.at);
                files.push((file, &item.at));
            }
        }
    }
    files
}

/// A file of changes of a graph, which is one of the values of a factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Variant {
    /// The file, relative to the graph's.
    pub file: String,
    /// Its content.
    pub text: String,
}

impl Variant {
    /// The setting of a run that has the variant.
    pub(crate) fn setting(&self) -> String {
        format!("extends={}", serde_json::Value::from(self.file.as_str()))
    }

    /// Reads the file at `path`, whose content is merged over a graph of the files `texts`.
    ///
    /// # Errors
    /// If it cannot be read, is no TOML, changes the sweep, or extends what the graph does not.
    pub(crate) fn read(file: String, path: &Path, texts: &[PathBuf]) -> Result<Self, Vec<Fault>> {
        let variant = Self { file, text: read(path).map_err(|fault| vec![*fault])? };
        let mut faults = Vec::new();
        let table = variant.table(path, &mut faults);
        if let Some(sweep) = table.get("sweep") {
            let fault = Fault::new("a variant changes a run, and not the sweep").at(&sweep.key_at, "not of a run");
            faults.push(fault.help("write [sweep] into the graph that is swept"));
        }
        let extended = table.get("extends").map(|entry| named(entry, path, &mut faults)).unwrap_or_default();
        let is_part = |file: &Path| texts.iter().any(|text| canonical(text) == canonical(file));
        for (file, at) in extended.into_iter().filter(|(file, _)| !is_part(file)) {
            let message =
                format!("the variant extends {}, which the graph of the sweep does not", tidy(&file).display());
            let help = "leave extends out, since a variant is merged over the graph, or let the graph extend that file";
            faults.push(Fault::new(message).at(at, "no part of the graph").help(help));
        }
        if faults.is_empty() { Ok(variant) } else { Err(faults) }
    }

    /// The content as a table.
    pub(super) fn table(&self, path: &Path, faults: &mut Vec<Fault>) -> Table {
        let (name, dir, text) = (tidy(path), PathBuf::new(), self.text.clone());
        let (merged, line_starts) = (OnceLock::new(), OnceLock::new());
        let source = SourceText { name, dir, text, order: 0, command_line: false, merged, used: None, line_starts };
        let mut table = parse(&Arc::new(source), faults);
        results::flatten(&mut table, faults);
        table
    }
}

/// The path without `x/..`, for display.
pub(crate) fn tidy(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for component in path.components() {
        match component {
            Component::ParentDir if matches!(out.components().next_back(), Some(Component::Normal(_))) => {
                out.pop();
            }
            Component::CurDir => {}
            other => out.push(other),
        }
    }
    out
}

pub(super) fn canonical(path: &Path) -> PathBuf {
    fs::canonicalize(path)
        .unwrap_or_else(|_| std::path::absolute(path).map_or_else(|_| path.into(), |path| tidy(&path)))
}
