//! What a plugin has loaded beside its own file.

use serde::{Deserialize, Serialize};
use std::{env, fmt::Write as _, path::PathBuf};

/// What a plugin has loaded beside its own file, as the process reports that has loaded it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Loads {
    /// Modules outside of the interpreter's packages, and shared libraries, by content.
    pub files: Vec<LoadedFile>,
    /// Distributions from which modules were imported: `NAME VERSION`.
    pub packages: Vec<String>,
    /// The interpreter, the limits of threads and the variables that nodes name: `CPython 3.11.7`, `OMP_NUM_THREADS=1`,
    /// `MODEL unset`.
    pub environment: Vec<String>,
    /// Names of the files, and the packages, that only firings loaded.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub late: Vec<String>,
    /// Data that firings opened and programs that they called.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub opened: Vec<LoadedFile>,
}

/// A module or a shared library.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LoadedFile {
    /// The name of the module, or of the library's file.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// Its SHA-256.
    pub sha256: String,
}

impl Loads {
    /// Whether nothing was loaded.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// What decides the numbers, as one text: names and contents, without paths.
    pub fn identity(&self) -> String {
        let mut text = String::new();
        for file in &self.files {
            let _ = writeln!(text, "file {} {}", file.name, file.sha256);
        }
        self.packages.iter().chain(&self.environment).for_each(|entry| text.extend([entry, "\n"]));
        text
    }

    /// What was loaded before the first firing and differs, in words, in which `names` are those of both: other contents, and what
    /// one of them has only.
    pub fn differences(&self, other: &Self, names: [&str; 2]) -> Vec<String> {
        self.changed(other).into_iter().chain(self.only_in_one(other, names, false)).collect()
    }

    /// What firings loaded or opened and differs, in words.
    pub fn late_differences(&self, other: &Self, names: [&str; 2]) -> Vec<String> {
        let both = self.opened.iter().filter_map(|file| Some((file, find(&other.opened, file)?)));
        let changed = both.filter(|(file, same)| file.sha256 != same.sha256);
        let changed =
            changed.map(|(file, _)| format!("{} ({}), which it opens, differs", file.name, file.path.display()));
        changed.chain(self.only_in_one(other, names, true)).collect()
    }

    /// The files and packages of one of them only, those of firings or the others.
    fn only_in_one(&self, other: &Self, names: [&str; 2], is_late: bool) -> Vec<String> {
        let only = |these: &Self, others: &Self, name: &str| -> Vec<String> {
            let files = these.files.iter().filter(|file| find(&others.files, file).is_none());
            let files = files.map(|file| (&file.name, format!("{} ({})", file.name, file.path.display())));
            let has = |entry: &str| others.packages.iter().any(|other| parts(other).0 == parts(entry).0);
            let packages = these.packages.iter().filter(|entry| !has(entry)).map(|entry| (entry, entry.clone()));
            let all = files.chain(packages).filter(|(key, _)| these.late.contains(key) == is_late);
            all.map(|(_, shown)| format!("{name} alone loads {shown}")).collect()
        };
        [only(self, other, names[0]), only(other, self, names[1])].concat()
    }

    /// What is there both times and is another, in words.
    pub fn changed(&self, now: &Self) -> Vec<String> {
        let mut differences = Vec::new();
        for (then, now) in self.files.iter().filter_map(|then| Some((then, find(&now.files, then)?))) {
            if then.sha256 != now.sha256 {
                differences.push(format!("{} ({}) differs", now.name, now.path.display()));
            }
        }
        for (then, now) in [(&self.packages, &now.packages), (&self.environment, &now.environment)] {
            for (then, name) in then.iter().map(|then| (then, parts(then).0)) {
                let other = now.iter().find(|now| parts(now).0 == name).filter(|now| *now != then);
                differences.extend(other.map(|other| format!("{then} against {}", parts(other).1)));
            }
        }
        differences
    }

    /// Adds variables, each `NAME=VALUE` or `NAME unset`; those that the process has reported stay as it has them.
    pub fn add_environment<'a>(&mut self, entries: impl Iterator<Item = &'a str>) {
        for entry in entries {
            if self.environment.iter().all(|known| parts(known).0 != parts(entry).0) {
                self.environment.push(entry.into());
            }
        }
    }

    /// Adds the variables that `then` names, as they are in this process.
    pub fn add_variables_of(&mut self, then: &Self) {
        let entries: Vec<_> = then.environment.iter().filter_map(|entry| variable(parts(entry).0)).collect();
        self.add_environment(entries.iter().map(String::as_str));
    }

    /// Adds what is new in `more`, which firings loaded; whether anything was.
    pub fn add(&mut self, more: &Self) -> bool {
        let new_entries = |known: &[String], more: &[String]| -> Vec<String> {
            let is_new = |entry: &&String| known.iter().all(|known| parts(known).0 != parts(entry).0);
            more.iter().filter(is_new).cloned().collect()
        };
        let new_files = |known: &[LoadedFile], more: &[LoadedFile]| -> Vec<LoadedFile> {
            more.iter().filter(|file| find(known, file).is_none()).cloned().collect()
        };
        let (files, opened) = (new_files(&self.files, &more.files), new_files(&self.opened, &more.opened));
        let packages = new_entries(&self.packages, &more.packages);
        self.environment.extend(new_entries(&self.environment, &more.environment));
        let is_more = !(files.is_empty() && opened.is_empty() && packages.is_empty());
        self.late.extend(files.iter().map(|file| file.name.clone()).chain(packages.iter().cloned()));
        self.files.extend(files);
        self.opened.extend(opened);
        self.packages.extend(packages);
        self.late.sort();
        self.packages.sort();
        self.files.sort_by(|a, b| a.path.cmp(&b.path));
        self.opened.sort_by(|a, b| a.path.cmp(&b.path));
        is_more
    }
}

/// A variable of this process as `NAME=VALUE` or `NAME unset`; `None` if its value is no text.
pub fn variable(name: &str) -> Option<String> {
    match env::var(name) {
        Ok(value) => Some(format!("{name}={value}")),
        Err(env::VarError::NotPresent) => Some(format!("{name} unset")),
        Err(env::VarError::NotUnicode(_)) => None,
    }
}

/// The file of this name.
fn find<'a>(files: &'a [LoadedFile], file: &LoadedFile) -> Option<&'a LoadedFile> {
    files.iter().find(|other| other.name == file.name)
}

/// Name and version, or name and value.
fn parts(entry: &str) -> (&str, &str) {
    entry.split_once('=').or_else(|| entry.rsplit_once(' ')).unwrap_or((entry, ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loads(helper: &str, packages: &[&str], environment: &[&str]) -> Loads {
        let of = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect();
        let file = LoadedFile { name: "helper".into(), path: "/p/helper.py".into(), sha256: helper.into() };
        Loads { files: vec![file], packages: of(packages), environment: of(environment), ..Loads::default() }
    }

    #[test]
    fn what_differs_is_named_with_what_one_of_them_loads_alone() {
        let then = loads("a", &["numpy 1.26.4"], &["CPython 3.11.7", "OMP_NUM_THREADS=1"]);
        let now = loads("b", &["numpy 2.0.2", "scipy 1.1"], &["CPython 3.11.7", "OMP_NUM_THREADS=2"]);
        let expected = ["helper (/p/helper.py) differs", "numpy 1.26.4 against 2.0.2", "OMP_NUM_THREADS=1 against 2"];
        assert_eq!(then.changed(&now), expected);
        assert_eq!(then.differences(&now, ["A", "B"])[3..], ["B alone loads scipy 1.1"]);
        assert_eq!(then.differences(&loads("a", &[], &[]), ["A", "B"]), ["A alone loads numpy 1.26.4"]);
    }

    #[test]
    fn what_only_firings_load_and_open_is_told_apart() {
        let file = |sha256: &str| LoadedFile { name: "w.txt".into(), path: "/p/w.txt".into(), sha256: sha256.into() };
        let (mut then, mut now) = (loads("a", &[], &[]), loads("a", &[], &[]));
        assert!(then.add(&Loads { opened: vec![file("1")], ..Loads::default() }));
        assert!(now.add(&Loads { opened: vec![file("2")], ..loads("a", &["fast 1"], &[]) }));
        assert!(then.differences(&now, ["A", "B"]).is_empty());
        let late = ["w.txt (/p/w.txt), which it opens, differs", "B alone loads fast 1"];
        assert_eq!(then.late_differences(&now, ["A", "B"]), late);
    }

    #[test]
    fn a_variable_that_was_set_meanwhile_is_a_difference() {
        let mut then = loads("a", &[], &["OMP_NUM_THREADS=1"]);
        let mut now = then.clone();
        then.add_environment(["MODEL unset", "OMP_NUM_THREADS=8"].into_iter());
        now.add_environment(["MODEL=unset"].into_iter());
        assert_eq!(then.environment, ["OMP_NUM_THREADS=1", "MODEL unset"], "what the process has reported stays");
        assert_eq!(then.changed(&now), ["MODEL unset against unset"]);
        assert_ne!(then.identity(), now.identity());
    }

    #[test]
    fn what_is_added_later_joins_the_rest_and_paths_are_no_part_of_the_identity() {
        let mut all = loads("a", &["numpy 1.26.4"], &[]);
        assert!(all.add(&loads("a", &["scipy 1.1"], &[])) && !all.add(&loads("a", &["scipy 1.1"], &[])));
        assert_eq!(all.packages, ["numpy 1.26.4", "scipy 1.1"]);
        let mut moved = all.clone();
        moved.files[0].path = "/elsewhere/helper.py".into();
        assert_eq!(moved.identity(), all.identity());
        assert_ne!(loads("b", &[], &[]).identity(), loads("a", &[], &[]).identity());
    }
}
