//! Paths as manifests and recordings show them: never absolute, since folders are named after people and patients.
//!
//! A file below the folder of the graph, or with it below the current folder, is shown relative to the graph, as graph files
//! name files; any other by its name alone. Its SHA-256 is beside it. With `sources = "hash"` paths stay absolute, since a
//! replay reads the files again; so do those of the libraries of plugins, which every replay loads.

use crate::{
    options::RunOptions,
    plan::{Plan, Sources},
};
use serde_json::Value as Json;
use std::{
    collections::BTreeMap,
    path::{Component, Path, PathBuf},
};

/// Replaces absolute paths in texts.
#[derive(Debug, Default, Clone)]
pub(crate) struct ShownPaths {
    /// Absolute path and what is shown, the longest first.
    pairs: Vec<(String, String)>,
}

impl ShownPaths {
    /// The paths of a run: its graph, the files that it names, the folder that it leaves and the store of cached answers.
    pub(crate) fn of(plan: &Plan, options: &RunOptions) -> Self {
        if plan.recording.sources == Sources::Hashes {
            return Self::default();
        }
        let current = std::env::current_dir().unwrap_or_default();
        let graph = current.join(&plan.path);
        let graph_dir = graph.parent().unwrap_or(&current).to_path_buf();
        let mut shown = BTreeMap::new();
        let named = plan.nodes.iter().flat_map(|node| &node.files).chain(&plan.input_files);
        for path in named.filter(|path| path.is_absolute()) {
            shown.insert(path.clone(), relative(path, &graph_dir, &current));
        }
        let store = options.store.as_ref().map(|store| store.dir());
        let others = [Some(plan.path.as_path()), options.out_dir.as_deref(), store];
        for path in others.into_iter().flatten().filter(|path| path.is_absolute()) {
            shown.insert(path.into(), relative(path, &current, &current));
        }
        distinguish(&mut shown);
        let mut pairs: Vec<(String, String)> =
            shown.into_iter().map(|(path, shown)| (path.display().to_string(), shown)).collect();
        pairs.sort_by_key(|(path, _)| std::cmp::Reverse(path.len()));
        Self { pairs }
    }

    /// The text with each of the paths as it is shown.
    pub(crate) fn text(&self, text: &str) -> String {
        self.pairs.iter().fold(text.to_owned(), |text, (path, shown)| replace(&text, path, shown))
    }

    /// A path as it is shown.
    pub(crate) fn path(&self, path: &Path) -> PathBuf {
        self.text(&path.display().to_string()).into()
    }

    /// The value with [`Self::text`] applied to every string in it.
    pub(crate) fn json(&self, mut value: Json) -> Json {
        self.apply(&mut value);
        value
    }

    fn apply(&self, value: &mut Json) {
        match value {
            Json::String(text) => *text = self.text(text),
            Json::Array(values) => values.iter_mut().for_each(|value| self.apply(value)),
            Json::Object(map) => map.values_mut().for_each(|value| self.apply(value)),
            _ => {}
        }
    }
}

/// Replaces a path where it is neither the beginning of a longer name nor the end of a longer path; one that ends in `/` where more
/// follows.
pub fn replace(text: &str, path: &str, shown: &str) -> String {
    let of_name = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-');
    let is_longer = |after: &str| {
        let ending = after.strip_prefix('.').is_some_and(|after| after.starts_with(char::is_alphanumeric));
        !path.ends_with('/') && (ending || after.starts_with(of_name))
    };
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find(path) {
        let (before, after) = (&rest[..at], &rest[at + path.len()..]);
        out.push_str(before);
        let is_whole = !is_longer(after) && !out.ends_with(|c: char| of_name(c) || c == '.');
        out.push_str(if is_whole { shown } else { path });
        rest = after;
    }
    out + rest
}

/// The path relative to `base` if it is below it, or if both are below `current`; otherwise its name.
fn relative(path: &Path, base: &Path, current: &Path) -> String {
    let name = || path.file_name().map_or_else(|| ".".into(), |name| name.to_string_lossy().into_owned());
    if path == base {
        return ".".into();
    }
    if let Ok(below) = path.strip_prefix(base) {
        return below.display().to_string();
    }
    if !(path.starts_with(current) && base.starts_with(current)) {
        return name();
    }
    let n_shared = path.components().zip(base.components()).take_while(|(a, b)| a == b).count();
    let up = base.components().skip(n_shared).map(|_| Component::ParentDir);
    up.chain(path.components().skip(n_shared)).collect::<PathBuf>().display().to_string()
}

/// Numbers equal names of different files.
fn distinguish(shown: &mut BTreeMap<PathBuf, String>) {
    let mut n_by_name = BTreeMap::<String, usize>::new();
    for name in shown.values_mut() {
        let n = n_by_name.entry(name.clone()).or_default();
        *n += 1;
        if *n > 1 {
            *name = format!("{name} ({n})");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_shown_relative_to_the_graph_or_by_its_name() {
        for (path, base, current, shown) in [
            ("/home/a/study/bone.stl", "/home/a/study", "/elsewhere", "bone.stl"),
            ("/home/a/data/bone.stl", "/home/a/graphs", "/home/a", "../data/bone.stl"),
            ("/home/a/data/bone.stl", "/home/a/graphs", "/home/a/graphs", "bone.stl"),
            ("/data/DOE_JOHN/ct", "/home/a/graphs", "/home/a", "ct"),
            ("/home/a", "/home/a", "/home/a", "."),
        ] {
            assert_eq!(relative(path.as_ref(), base.as_ref(), current.as_ref()), shown, "{path}");
        }
    }

    #[test]
    fn a_path_within_a_text_is_replaced_and_a_longer_name_is_not() {
        let paths = ShownPaths { pairs: vec![("/d/ct/1.dcm".into(), "1.dcm".into()), ("/d/ct".into(), "ct".into())] };
        let text =
            "/d/ct/1.dcm: cut; folder /d/ct, --set bone.path=/d/ct and /d/ct2 /d/ct/2.dcm, not ../d/ct or /e/d/ct";
        let shown = "1.dcm: cut; folder ct, --set bone.path=ct and /d/ct2 ct/2.dcm, not ../d/ct or /e/d/ct";
        assert_eq!(paths.text(text), shown);
    }

    #[test]
    fn files_of_one_name_stay_apart() {
        let mut shown =
            BTreeMap::from([("/a/bone.stl".into(), "bone.stl".into()), ("/b/bone.stl".into(), "bone.stl".into())]);
        distinguish(&mut shown);
        assert_eq!(shown.values().collect::<Vec<_>>(), ["bone.stl", "bone.stl (2)"]);
    }
}
