use super::{
    extract::refused,
    limits::MAX_EXTENDS,
    merge::merge,
    parse::parse,
    plugins::{self, NamedPlugin},
    remove::Removed,
    results,
    tree::Table,
};
use crate::{
    fault::{Fault, SourceText, Span, Use},
    hash::files::irregular,
    names::nearest,
};
use std::{
    fs, io,
    path::{Component, Path, PathBuf},
    sync::Arc,
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

/// The files read so far, each extending the next.
pub(super) struct Chain<'f> {
    /// Canonical paths, which detect a cycle through links, with the names shown.
    seen: Vec<(PathBuf, PathBuf)>,
    /// The extended files, whether or not they could be read.
    pub(super) texts: Vec<PathBuf>,
    /// The plugins named by these files; those of a file follow those of the file it extends.
    pub(super) plugins: Vec<NamedPlugin>,
    /// The order of the first text among all texts of the graph.
    order: usize,
    /// The node that uses the file as a module.
    used: Option<(String, Span)>,
    removed: &'f mut Removed,
    faults: &'f mut Vec<Fault>,
}

impl<'f> Chain<'f> {
    pub(super) fn new(removed: &'f mut Removed, faults: &'f mut Vec<Fault>) -> Self {
        let (seen, texts, plugins) = (Vec::new(), Vec::new(), Vec::new());
        Self { seen, texts, plugins, order: 0, used: None, removed, faults }
    }

    /// The chain of a module's file.
    pub(super) fn used(self, node: &str, at: &Span, order: usize) -> Self {
        Self { used: Some((node.into(), at.clone())), order, ..self }
    }

    pub(super) fn len(&self) -> usize {
        self.seen.len()
    }

    /// Loads a graph file with everything it extends.
    pub(super) fn load(&mut self, path: &Path, text: String) -> (Arc<SourceText>, Table) {
        let name = tidy(path);
        let dir = std::path::absolute(path).ok().and_then(|p| p.parent().map(Path::to_path_buf)).unwrap_or_default();
        let used = self.used.as_ref().map(|(node, at)| Use { node: node.clone(), at: at.clone() });
        let order = self.order + self.seen.len();
        let source = Arc::new(SourceText { name, dir, text, order, command_line: false, used });
        self.seen.push((canonical(path), source.name.clone()));
        let mut over = parse(&source, self.faults);
        results::flatten(&mut over, self.faults);
        let named = plugins::take(&mut over, self.faults);
        let mut base = self.base(&mut over, path);
        self.plugins.extend(named);
        self.removed.take_from(&mut base, &mut over, self.faults);
        merge(&mut base, over);
        (source, base)
    }

    /// The table of the extended file; empty if the file extends nothing.
    fn base(&mut self, over: &mut Table, path: &Path) -> Table {
        let Some(entry) = over.remove("extends") else { return Table::default() };
        let Some(text) = entry.value.as_text() else {
            let fault = refused(&entry.value, "extends takes the path of a graph file", "a text is needed");
            self.faults.push(fault.hides(&entry.value.at));
            return Table::default();
        };
        let base = path.parent().unwrap_or(Path::new("")).join(text);
        let same = canonical(&base);
        if let Some(start) = self.seen.iter().position(|(seen, _)| *seen == same) {
            let names: Vec<_> = self.seen[start..].iter().map(|(_, name)| name.display().to_string()).collect();
            let message = format!("files extend each other in a circle: {} -> {}", names.join(" -> "), names[0]);
            self.faults.push(Fault::new(message).at(&entry.value.at, "closes the circle").hides(&entry.value.at));
            return Table::default();
        }
        if self.seen.len() == MAX_EXTENDS {
            let fault = Fault::new(format!("more than {MAX_EXTENDS} files extend each other"));
            let fault = fault.at(&entry.value.at, "one too many").help("does a program write these files?");
            self.faults.push(fault.hides(&entry.value.at));
            return Table::default();
        }
        self.texts.push(base.clone());
        match read(&base) {
            Ok(text) => self.load(&base, text).1,
            Err(fault) => {
                self.faults.push(fault.at(&entry.value.at, "relative to this file").hides(&entry.value.at));
                Table::default()
            }
        }
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
    fs::canonicalize(path).unwrap_or_else(|_| std::path::absolute(path).unwrap_or_else(|_| path.into()))
}
