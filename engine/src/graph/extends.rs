use super::{
    merge::merge,
    parse::parse,
    results,
    tree::{Table, Value},
};
use crate::{
    check::nearest,
    fault::{Fault, SourceText, Span},
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
    // Editors on Windows begin a file with a mark that is no part of the text.
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

/// The files read so far, each extending the next.
pub(super) struct Chain<'f> {
    path: PathBuf,
    /// Canonical paths, to see a cycle through links, and the names shown.
    seen: Vec<(PathBuf, PathBuf)>,
    faults: &'f mut Vec<Fault>,
}

impl<'f> Chain<'f> {
    pub(super) fn new(path: &Path, faults: &'f mut Vec<Fault>) -> Self {
        Self { path: path.into(), seen: Vec::new(), faults }
    }

    pub(super) fn len(&self) -> usize {
        self.seen.len()
    }

    /// The graph file with everything it extends.
    pub(super) fn load(&mut self, text: String) -> (Arc<SourceText>, Table) {
        let path = self.path.clone();
        self.layer(&path, text)
    }

    fn layer(&mut self, path: &Path, text: String) -> (Arc<SourceText>, Table) {
        let name = tidy(path);
        let dir = std::path::absolute(path).ok().and_then(|p| p.parent().map(Path::to_path_buf)).unwrap_or_default();
        let source = Arc::new(SourceText { name, dir, text, order: self.seen.len(), command_line: false });
        self.seen.push((canonical(path), source.name.clone()));
        let mut over = parse(&source, self.faults);
        results::flatten(&mut over, self.faults);
        let mut base = self.base(&mut over, path);
        remove(&mut base, &mut over, self.faults);
        merge(&mut base, over);
        (source, base)
    }

    /// What the file extends; empty if nothing.
    fn base(&mut self, over: &mut Table, path: &Path) -> Table {
        let Some(entry) = over.remove("extends") else { return Table::default() };
        let Some(text) = entry.value.as_text() else {
            let fault = format!("extends takes the path of a graph file, found {}", entry.value.found());
            self.faults.push(Fault::new(fault).at(&entry.value.at, "a text is needed").hides(&entry.value.at));
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
        match read(&base) {
            Ok(text) => self.layer(&base, text).1,
            Err(fault) => {
                self.faults.push(fault.at(&entry.value.at, "relative to this file").hides(&entry.value.at));
                Table::default()
            }
        }
    }
}

/// The path without `x/..`, for show.
fn tidy(path: &Path) -> PathBuf {
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

fn canonical(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| std::path::absolute(path).unwrap_or_else(|_| path.into()))
}

/// Takes from `base` what `remove` of `over` names.
pub(super) fn remove(base: &mut Table, over: &mut Table, faults: &mut Vec<Fault>) {
    let Some(entry) = over.remove("remove") else { return };
    let Value::Array(items) = &entry.value.value else {
        let message = format!("remove takes a list such as [\"node.x\", \"results.y\"], found {}", entry.value.found());
        faults.push(Fault::new(message).at(&entry.value.at, "a list is needed"));
        return;
    };
    for item in items {
        match item.as_text() {
            Some(path) => {
                if !remove_path(base, path) {
                    faults.push(nothing_there(base, path, &item.at));
                }
            }
            None => {
                let message = format!("remove takes texts such as \"node.x\", found {}", item.found());
                faults.push(Fault::new(message).at(&item.at, "a text is needed"));
            }
        }
    }
}

fn remove_path(table: &mut Table, path: &str) -> bool {
    if table.remove(path).is_some() {
        return true;
    }
    // The key of a result has dots of its own, and a group of results is named by what they share.
    let group = format!("{path}.");
    let before = table.0.len();
    table.0.retain(|entry| !entry.key.starts_with(&group));
    if table.0.len() < before {
        return true;
    }
    path.match_indices('.').any(|(dot, _)| match table.get_mut(&path[..dot]) {
        Some(entry) => match &mut entry.value.value {
            Value::Table(inner) => remove_path(inner, &path[dot + 1..]),
            _ => false,
        },
        None => false,
    })
}

fn nothing_there(base: &Table, path: &str, at: &Span) -> Fault {
    let mut known = Vec::new();
    for entry in &base.0 {
        if let Value::Table(inner) = &entry.value.value {
            known.extend(inner.keys().map(|key| format!("{}.{key}", entry.key)));
            if entry.key == "node" {
                for node in &inner.0 {
                    let keys = node.value.as_table().into_iter().flat_map(Table::keys);
                    known.extend(keys.map(|key| format!("node.{}.{key}", node.key)));
                }
            }
        }
    }
    let message = format!("nothing to remove: the extended graph has no \"{path}\"");
    let near = nearest::name(path, known.iter().map(String::as_str));
    let help = near.map(|near| format!("did you mean \"{near}\"?"));
    Fault::new(message).at(at, "not there").help_if(help).follows()
}
