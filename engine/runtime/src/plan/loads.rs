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

    /// What is there both times and is another, in words. What is there once only is no difference: a module may be imported
    /// by a firing, and a changed `import` is one of a file.
    pub fn differences(&self, now: &Self) -> Vec<String> {
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

    /// Adds what is new in `more`; whether anything was.
    pub fn add(&mut self, more: &Self) -> bool {
        let before = (self.files.len(), self.packages.len());
        self.files
            .extend(more.files.iter().filter(|file| find(&self.files, file).is_none()).cloned().collect::<Vec<_>>());
        self.files.sort_by(|a, b| a.path.cmp(&b.path));
        let is_new = |entry: &&String| self.packages.iter().all(|known| parts(known).0 != parts(entry).0);
        self.packages.extend(more.packages.iter().filter(is_new).cloned().collect::<Vec<_>>());
        self.packages.sort();
        before != (self.files.len(), self.packages.len())
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
        Loads { files: vec![file], packages: of(packages), environment: of(environment) }
    }

    #[test]
    fn what_differs_is_named_and_what_came_in_addition_is_not() {
        let then = loads("a", &["numpy 1.26.4"], &["CPython 3.11.7", "OMP_NUM_THREADS=1"]);
        let now = loads("b", &["numpy 2.0.2", "scipy 1.1"], &["CPython 3.11.7", "OMP_NUM_THREADS=2"]);
        let expected = ["helper (/p/helper.py) differs", "numpy 1.26.4 against 2.0.2", "OMP_NUM_THREADS=1 against 2"];
        assert_eq!(then.differences(&now), expected);
        assert!(then.differences(&loads("a", &[], &[])).is_empty());
    }

    #[test]
    fn a_variable_that_was_set_meanwhile_is_a_difference() {
        let mut then = loads("a", &[], &["OMP_NUM_THREADS=1"]);
        let mut now = then.clone();
        then.add_environment(["MODEL unset", "OMP_NUM_THREADS=8"].into_iter());
        now.add_environment(["MODEL=unset"].into_iter());
        assert_eq!(then.environment, ["OMP_NUM_THREADS=1", "MODEL unset"], "what the process has reported stays");
        assert_eq!(then.differences(&now), ["MODEL unset against unset"]);
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
