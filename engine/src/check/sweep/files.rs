//! Values of a factor that are files: those that a pattern matches, or variants of the graph.

use super::{Reader, factor::MAX_LEVELS, spec::Level};
use crate::{
    fault::{Fault, Span},
    graph::{
        Entry, Spanned, Value, Variant,
        extract::{self, Section},
    },
    names::{glob, nearest},
};
use serde_json::Value as Json;
use std::{
    cmp::Ordering,
    fs,
    iter::Peekable,
    path::{Path, PathBuf},
    str::Chars,
};

impl Reader<'_> {
    /// `files = "scans/*.ply"`: the key has each file that matches.
    pub(super) fn files(&mut self, table: &Section<'_>, files: &Entry, owner: &str) -> Option<Vec<Level>> {
        let keys = self.keys(table, owner, true);
        let pattern = extract::text(&files.value, &table.what("files"), self.faults)?;
        let files = self.matching(pattern, &files.value.at, owner)?;
        let labels = self.labels(table, files.len(), owner)?.unwrap_or_else(|| labels(&files));
        let sets = |file: &String| keys.iter().map(|key| format!("{key}={}", Json::from(file.as_str()))).collect();
        let level = |(label, file): (String, &String)| Level { label: label.into(), sets: sets(file), variant: None };
        Some(labels.into_iter().zip(&files).map(level).collect())
    }

    /// `variants = "variants/*.toml"`, or a list: each file is merged over the graph.
    pub(super) fn variants(&mut self, table: &Section<'_>, variants: &Entry, owner: &str) -> Option<Vec<Level>> {
        if let Some(key) = ["key", "keys"].iter().find_map(|key| table.get(key)) {
            let help = "take it away, or write the values of the key as values = [..]";
            self.fault(&key.key_at, format!("{owner} has variants and a key"), "a variant sets its own keys", help);
            return None;
        }
        let files = match &variants.value.value {
            Value::Text(pattern) => self.matching(pattern, &variants.value.at, owner)?,
            _ => {
                let items = match &variants.value.value {
                    Value::Array(items) => items.as_slice(),
                    _ => &[],
                };
                self.texts(&variants.value, &table.what("variants"));
                let file = |item: &Spanned| Some(self.relative(&item.at, Path::new(item.as_text()?)));
                items.iter().filter_map(file).collect()
            }
        };
        let labels = self.labels(table, files.len(), owner)?.unwrap_or_else(|| labels(&files));
        let mut levels = Vec::new();
        for (label, file) in labels.into_iter().zip(files) {
            let path = self.graph.folder().join(&file);
            match Variant::read(file, &path, &self.graph.texts) {
                Ok(variant) => {
                    levels.push(Level { label: label.into(), sets: vec![variant.setting()], variant: Some(variant) });
                }
                Err(faults) => {
                    let at = |fault: Fault| match fault.location() {
                        Some(_) => fault,
                        None => fault.at(&variants.value.at, "relative to this file"),
                    };
                    self.faults.extend(faults.into_iter().map(at));
                }
            }
        }
        Some(levels)
    }

    /// The files that match, as paths relative to the graph; at least one.
    fn matching(&mut self, pattern: &str, at: &Span, owner: &str) -> Option<Vec<String>> {
        let (folder, rest) = split(pattern);
        let start = at.dir().join(&folder);
        let mut paths = vec![folder.clone()];
        for segment in &rest {
            paths = paths.iter().flat_map(|dir| entries(&at.dir().join(dir), segment, dir)).collect();
        }
        if paths.len() as u64 > MAX_LEVELS {
            let message = format!("{owner} has {} values, at most {MAX_LEVELS} are possible", paths.len());
            self.fault(at, message, "too many", "split the sweep by narrower patterns");
            return None;
        }
        if paths.is_empty() {
            let fault = Fault::new(format!("{owner}: no file matches {pattern}")).at(at, "relative to this file");
            let names = entries(&start, "*", Path::new(""));
            let names: Vec<_> = names.iter().filter_map(|name| name.to_str()).collect();
            let shown = match folder.as_os_str().is_empty() {
                true => "the folder of this file".into(),
                false => folder.display().to_string(),
            };
            let has = match (start.is_dir(), names.is_empty()) {
                (false, _) => Some(format!("there is no folder {shown}")),
                (true, true) => Some(format!("{shown} is empty")),
                (true, false) => nearest::all(&format!("{shown} has"), names),
            };
            self.faults.push(fault.note_if(has).help("* stands for any part of a name, ? for one character"));
            return None;
        }
        paths.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
        Some(paths.iter().map(|file| self.relative(at, file)).collect())
    }

    /// A path that is written at `at`, relative to the graph if it is in the graph's folder.
    fn relative(&self, at: &Span, file: &Path) -> String {
        let of_graph = &self.graph.main.dir;
        let path = match at.dir() == of_graph {
            true => file.to_path_buf(),
            false => {
                let path = at.dir().join(file);
                path.strip_prefix(of_graph).map(Path::to_path_buf).unwrap_or(path)
            }
        };
        path.to_string_lossy().into_owned()
    }
}

/// The stems of the files; if two are the same, the paths.
fn labels(files: &[String]) -> Vec<String> {
    let stem = |file: &String| Path::new(file).file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let mut stems: Vec<String> = files.iter().filter_map(stem).collect();
    let labels = stems.clone();
    stems.sort();
    stems.dedup();
    if stems.len() == files.len() { labels } else { files.to_vec() }
}

/// The folders before the first segment with a wildcard, and the segments from there on.
fn split(pattern: &str) -> (PathBuf, Vec<&str>) {
    let is_plain = |segment: &&str| !segment.contains(['*', '?']);
    let segments: Vec<_> = pattern.split('/').collect();
    let n_plain = segments.iter().take_while(|segment| is_plain(segment)).count().min(segments.len() - 1);
    let folder = segments[..n_plain].join("/");
    let folder = if folder.is_empty() && pattern.starts_with('/') { "/".into() } else { folder };
    (folder.into(), segments[n_plain..].to_vec())
}

/// The entries of a folder whose name a segment of a pattern matches, under `shown`. Hidden ones need a dot in the pattern.
fn entries(folder: &Path, segment: &str, shown: &Path) -> Vec<PathBuf> {
    let names = fs::read_dir(folder).into_iter().flatten().flatten().filter_map(|e| e.file_name().into_string().ok());
    let names = names.filter(|name| glob::fits(segment, name) && (segment.starts_with('.') || !name.starts_with('.')));
    names.map(|name| shown.join(name)).collect()
}

/// The order of names in which `scan_2` is before `scan_10`.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.chars().peekable(), b.chars().peekable());
    loop {
        let order = match (left.peek(), right.peek()) {
            (Some(x), Some(y)) if x.is_ascii_digit() && y.is_ascii_digit() => {
                let (x, y) = (digits(&mut left), digits(&mut right));
                x.len().cmp(&y.len()).then_with(|| x.cmp(&y))
            }
            (None, None) => return a.cmp(b),
            _ => left.next().cmp(&right.next()),
        };
        if order != Ordering::Equal {
            return order;
        }
    }
}

/// The digits at the front, without leading zeros.
fn digits(text: &mut Peekable<Chars<'_>>) -> String {
    let mut digits = String::new();
    while let Some(digit) = text.next_if(char::is_ascii_digit) {
        digits.push(digit);
    }
    digits.trim_start_matches('0').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_matched_and_numbers_in_them_are_in_their_order() {
        for (segment, name, so) in [
            ("*.ply", "a.ply", true),
            ("*.ply", "a.ply.bak", false),
            ("scan_?.ply", "scan_3.ply", true),
            ("scan_?.ply", "scan_33.ply", false),
            ("*a*b*", "xxaxxbxx", true),
            ("*a*b*", "xxbxxa", false),
            ("a", "b", false),
            ("a", "ab", false),
        ] {
            assert_eq!(glob::fits(segment, name), so, "{segment} {name}");
        }
        let mut names = ["s10", "s2", "s02", "s1b", "t", "s"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["s", "s1b", "s02", "s2", "s10", "t"]);
        assert_eq!(split("/a/b*/c"), ("/a".into(), vec!["b*", "c"]));
        assert_eq!(split("a/b.ply"), ("a".into(), vec!["b.ply"]));
        assert_eq!(labels(&["a/s.ply".into(), "b/s.ply".into()]), ["a/s.ply", "b/s.ply"]);
    }
}
