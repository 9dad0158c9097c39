//! Names of files in place of their paths: folders are named after people and patients.

use osteoflow_draw::xml::escape;
use osteoflow_engine::replace_path;
use serde_json::Value as Json;
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

/// Paths and what a page shows of them.
#[derive(Debug, Default)]
pub(crate) struct Paths {
    /// As in HTML, the longest first.
    pairs: Vec<(String, String)>,
}

impl Paths {
    /// The absolute paths in a `manifest.json` or `sweep.json`, and the folder `dir` that holds it.
    pub(crate) fn of(about: &Json, dir: &Path) -> Self {
        let mut found = BTreeSet::new();
        absolute(about, &mut found);
        found.extend(
            [dir.to_owned(), std::path::absolute(dir).unwrap_or_default()].into_iter().filter(|dir| dir.is_absolute()),
        );
        let mut pairs: Vec<(String, String)> = Vec::new();
        for path in found {
            let Some(name) = path.file_name().map(|name| escape(&name.to_string_lossy())) else { continue };
            let alike =
                pairs.iter().filter(|(_, shown)| *shown == name || shown.starts_with(&format!("{name} ("))).count();
            let shown = if alike == 0 { name } else { format!("{name} ({})", alike + 1) };
            pairs.push((escape(&path.display().to_string()), shown));
            let folder = path.parent().filter(|folder| folder.parent().is_some());
            pairs.extend(folder.map(|folder| (escape(&format!("{}/", folder.display())), String::new())));
        }
        pairs.sort_by(|(a, _), (b, _)| b.len().cmp(&a.len()).then(a.cmp(b)));
        pairs.dedup();
        Self { pairs }
    }

    /// HTML or SVG without the paths.
    pub(crate) fn hidden(&self, html: &str) -> String {
        self.pairs.iter().fold(html.to_owned(), |html, (path, shown)| match html.contains(path) {
            true => replace_path(&html, path, shown),
            false => html,
        })
    }
}

/// The texts that are absolute paths, also behind `KEY=`, under the keys that hold paths.
fn absolute(json: &Json, out: &mut BTreeSet<PathBuf>) {
    match json {
        Json::Array(items) => items.iter().for_each(|item| absolute(item, out)),
        Json::Object(entries) => {
            for (key, value) in entries {
                match (key.as_str(), value) {
                    ("path" | "file" | "dir" | "interpreter", Json::String(path)) => out.extend(path_in(path)),
                    ("arguments" | "sets", Json::Array(texts)) => {
                        out.extend(texts.iter().filter_map(Json::as_str).filter_map(path_in));
                    }
                    (_, value) => absolute(value, out),
                }
            }
        }
        _ => {}
    }
}

fn path_in(text: &str) -> Option<PathBuf> {
    let path = Path::new(match text.split_once('=') {
        Some((_, value)) if !Path::new(text).is_absolute() => value.trim().trim_matches(['"', '\'']),
        _ => text,
    });
    path.is_absolute().then(|| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_page_shows_files_by_name_and_tells_files_of_one_name_apart() {
        let about = json!({
            "inputs": [{ "path": "/d/DOE/a.stl" }, { "path": "/d/ROE/a.stl" }],
            "command": { "arguments": ["run", "/d/DOE/g & h.toml", "--set", "scan.path=\"/d/x.ply\""] }, "topic": "/camera/pose",
        });
        let paths = Paths::of(&about, Path::new("out"));
        let html = "<td>/d/DOE/a.stl</td> /d/ROE/a.stl: cut, /d/DOE/g &amp; h.toml /d/x.ply /d/DOE/other /camera/pose";
        assert_eq!(paths.hidden(html), "<td>a.stl</td> a.stl (2): cut, g &amp; h.toml x.ply other /camera/pose");
    }
}
