//! The names of files in an archive, in place of their paths on the machine on which it was made.

use osteoflow_engine::replace_path;
use serde_json::Value as Json;
use std::path::{Component, Path, PathBuf};
use toml_edit::{DocumentMut, Item, Value};

/// Keys of `manifest.json` and `sweep.json` that hold a path of the machine.
const PATHS: [&str; 5] = ["path", "file", "dir", "interpreter", "arguments"];

/// Paths and what replaces them.
#[derive(Debug, Default)]
pub(super) struct Renamed {
    /// The folder of the graph file, absolute.
    graph_dir: PathBuf,
    /// Files and folders, absolute, with their names in the archive.
    paths: Vec<(PathBuf, String)>,
    /// The same and the folders above them as texts, the longest first.
    texts: Vec<(String, String)>,
}

/// The path without `.` and `..`, absolute.
pub(super) fn plain(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    let path = if path == Path::new("") { Path::new(".") } else { path };
    for part in std::path::absolute(path).unwrap_or_else(|_| path.into()).components() {
        match part {
            Component::ParentDir => drop(out.pop()),
            Component::CurDir => {}
            part => out.push(part),
        }
    }
    out
}

impl Renamed {
    pub(super) fn of(graph_dir: &Path) -> Self {
        Self { graph_dir: plain(graph_dir), ..Self::default() }
    }

    /// A path as a graph writes it, absolute.
    pub(super) fn resolved(&self, path: &str) -> PathBuf {
        plain(&self.graph_dir.join(path))
    }

    pub(super) fn add(&mut self, path: &Path, name: &str) {
        let path = plain(path);
        if self.name(&path).is_some() {
            return;
        }
        self.add_text(path.to_string_lossy().into_owned(), name.into());
        if let Some(parent) = path.parent().filter(|parent| parent.parent().is_some()) {
            self.add_text(format!("{}/", parent.display()), String::new());
        }
        self.paths.push((path, name.into()));
    }

    pub(super) fn add_text(&mut self, text: String, name: String) {
        if !self.texts.iter().any(|(known, _)| *known == text) {
            self.texts.push((text, name));
            self.texts.sort_by(|(a, _), (b, _)| b.len().cmp(&a.len()).then(a.cmp(b)));
        }
    }

    /// The name of a file or folder in the archive.
    pub(super) fn name(&self, path: &Path) -> Option<&str> {
        self.paths.iter().find(|(known, _)| known == path).map(|(_, name)| name.as_str())
    }

    /// The name of a file or folder that has one, or that is within a folder that has one.
    pub(super) fn name_below(&self, path: &Path) -> Option<String> {
        let above = |above: &Path| Some((self.name(above)?, path.strip_prefix(above).ok()?));
        let (name, below) = path.ancestors().find_map(above)?;
        Some(if below == Path::new("") { name.into() } else { format!("{name}/{}", below.display()) })
    }

    /// A text without known paths of the machine.
    pub(super) fn text(&self, text: &str) -> String {
        if !text.contains('/') {
            return text.into();
        }
        self.texts.iter().fold(text.to_owned(), |text, (path, name)| replace_path(&text, path, name))
    }

    /// The name for a text of a graph that is a known path; `key`: the last part of its key. A word may be a folder's name by
    /// chance, such as a frame's, so relative folders are looked up for the keys of paths alone.
    fn name_of(&self, key: &str, text: &str) -> Option<String> {
        let path = self.resolved(text);
        let is_plain = Path::new(text).is_absolute() || is_path_key(key) || path.extension().is_some();
        is_plain.then(|| self.name(&path).map(str::to_owned)).flatten()
    }

    /// The text of a graph file whose known paths are replaced.
    pub(super) fn graph(&self, toml: &str) -> String {
        self.text(&changed(toml, &mut |key, text| self.name_of(key, text)).unwrap_or_else(|| toml.into()))
    }

    /// A setting `KEY=VALUE` whose known paths are replaced.
    pub(super) fn set(&self, set: &str) -> String {
        let changed = set_changed(set, &mut |key, text| self.name_of(key, text));
        self.text(&changed.unwrap_or_else(|| set.into()))
    }

    /// JSON without known paths, and without the folders of those that stand where a path does.
    pub(super) fn json(&self, json: &mut Json) {
        match json {
            Json::String(text) => *text = self.text(text),
            Json::Array(items) => items.iter_mut().for_each(|item| self.json(item)),
            Json::Object(entries) => {
                for (key, value) in entries {
                    match key.as_str() {
                        "set" | "sets" => each_text(value, &|text| self.set(text)),
                        "resolved_graph" => each_text(value, &|text| self.graph(text)),
                        key => {
                            self.json(value);
                            if PATHS.contains(&key) {
                                each_text(value, &without_folder);
                            }
                        }
                    }
                }
            }
            _ => {}
        }
    }
}

/// Whether a parameter of this name holds a path.
pub(super) fn is_path_key(key: &str) -> bool {
    ["path", "paths", "file", "files", "folder", "dir"].iter().any(|end| key.ends_with(end))
}

/// The texts of a graph, each with the last part of its key, replaced by what `change` gives for them; `None` for what is no TOML.
pub(super) fn changed(toml: &str, change: &mut dyn FnMut(&str, &str) -> Option<String>) -> Option<String> {
    let mut document: DocumentMut = toml.parse().ok()?;
    document.as_table_mut().iter_mut().for_each(|(key, item)| in_item(item, key.get(), change));
    Some(document.to_string())
}

/// As [`changed`], of a setting.
pub(super) fn set_changed(set: &str, change: &mut dyn FnMut(&str, &str) -> Option<String>) -> Option<String> {
    let (key, value) = set.split_once('=')?;
    let mut value: Value = value.trim().parse().ok()?;
    in_value(&mut value, key.rsplit('.').next().unwrap_or(key).trim(), change);
    Some(format!("{key}={}", value.to_string().trim()))
}

fn in_item(item: &mut Item, key: &str, change: &mut dyn FnMut(&str, &str) -> Option<String>) {
    match item {
        Item::Value(value) => in_value(value, key, change),
        Item::Table(table) => table.iter_mut().for_each(|(key, item)| in_item(item, key.get(), change)),
        Item::ArrayOfTables(tables) => {
            let entries = tables.iter_mut().flat_map(|table| table.iter_mut());
            entries.for_each(|(key, item)| in_item(item, key.get(), change));
        }
        Item::None => {}
    }
}

fn in_value(value: &mut Value, key: &str, change: &mut dyn FnMut(&str, &str) -> Option<String>) {
    match value {
        Value::String(text) => {
            if let Some(new) = change(key, text.value()) {
                let decor = text.decor().clone();
                *value = new.into();
                *value.decor_mut() = decor;
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| in_value(item, key, change)),
        Value::InlineTable(table) => table.iter_mut().for_each(|(key, value)| in_value(value, key.get(), change)),
        _ => {}
    }
}

fn each_text(json: &mut Json, change: &dyn Fn(&str) -> String) {
    match json {
        Json::String(text) => *text = change(text),
        Json::Array(items) => items.iter_mut().for_each(|item| each_text(item, change)),
        _ => {}
    }
}

/// An absolute path, also behind `KEY=`, by its last name alone.
fn without_folder(text: &str) -> String {
    let (before, path) = match text.split_once('=') {
        Some((key, path)) if !Path::new(text).is_absolute() => (format!("{key}="), path),
        _ => (String::new(), text),
    };
    match Path::new(path).file_name().filter(|_| Path::new(path).is_absolute()) {
        Some(name) => before + &name.to_string_lossy(),
        None => text.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn renamed() -> Renamed {
        let mut renamed = Renamed::of(Path::new("/home/me/graphs"));
        renamed.add(Path::new("/home/me/DOE/bone.stl"), "inputs/1/bone.stl");
        renamed.add(Path::new("/home/me/graphs/my.py"), "plugins/1/my.py");
        renamed
    }

    #[test]
    fn a_path_is_replaced_where_it_ends_and_its_folder_where_it_goes_on() {
        let text = |text| renamed().text(text);
        assert_eq!(text("read /home/me/DOE/bone.stl."), "read inputs/1/bone.stl.");
        assert_eq!(text("/home/me/DOE/bone.stl2 /home/me/DOE/other"), "bone.stl2 other");
        assert_eq!(text("/camera/pose"), "/camera/pose");
    }

    #[test]
    fn paths_from_the_folder_of_the_graph_are_replaced_in_graphs_and_settings() {
        let r = renamed();
        let mut of_frame = renamed();
        of_frame.add(Path::new("/home/me/graphs/ct"), "inputs/2/ct");
        assert_eq!(
            of_frame.graph("[a]\npath = \"ct\"\nframe = \"ct\" # c\n"),
            "[a]\npath = \"inputs/2/ct\"\nframe = \"ct\" # c\n"
        );
        assert_eq!(
            r.graph("plugins = ['my.py']\n[a]\nb = \"../DOE/bone.stl\"\n"),
            "plugins = [\"plugins/1/my.py\"]\n[a]\nb = \"inputs/1/bone.stl\"\n"
        );
        assert_eq!(r.set("bone.path=\"../DOE/bone.stl\""), "bone.path=\"inputs/1/bone.stl\"");
        assert_eq!(r.set("icp.kind=\"icp.point_to_plane\""), "icp.kind=\"icp.point_to_plane\"");
    }

    #[test]
    fn an_unknown_path_loses_its_folder_where_a_path_stands_and_a_topic_stays() {
        let mut about = json!({ "arguments": ["run", "/x/g.toml", "--set", "a.path=/x/y"], "store": { "dir": "/c/s" }, "topic": "/a/b" });
        renamed().json(&mut about);
        assert_eq!(
            about,
            json!({ "arguments": ["run", "g.toml", "--set", "a.path=y"], "store": { "dir": "s" }, "topic": "/a/b" })
        );
    }
}
