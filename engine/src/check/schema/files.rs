use super::{Files, Quantity, Walker};
use crate::{fault::Fault, graph::Spanned, irregular, names::nearest};
use serde_json::Value as Json;
use std::path::{Path, PathBuf};

impl Walker<'_> {
    /// Reads an input path relative to the file it is written in; returns it absolute. A missing file or folder is a
    /// fault.
    pub(super) fn path(&mut self, value: &Spanned, text: &str, what: &Quantity) -> Option<Json> {
        let fault = |message: String| Fault::new(format!("{}: {}: {message}", self.owner, what.name));
        let problem = if text.is_empty() {
            Some(fault("an empty path names no file".into()).at(&value.at, "empty").note_if(what.doc.clone()))
        } else {
            None
        };
        let path = tidy(&value.at.dir().join(text));
        let problem = problem.or_else(|| {
            (self.files == Files::Needed).then_some(())?;
            let shown = path.display();
            if !path.exists() {
                let from = if value.at.source.command_line { "the current folder" } else { "this file" };
                let label = if Path::new(text).is_absolute() { "not there".into() } else { relative(from) };
                let missing = fault(format!("there is no file {shown}")).at(&value.at, label);
                return Some(missing.help_if(nearest::file(&path)));
            }
            if let Some(kind) = irregular(&path) {
                let wrong = fault(format!("{shown} is {kind}, but a file is needed")).at(&value.at, kind);
                return Some(wrong.help("copy what it gives into a file"));
            }
            if path.is_file() && text.ends_with(['/', '\\']) {
                let mixed = fault(format!("{shown} is a file, not a folder")).at(&value.at, "ends like a folder");
                return Some(mixed.help("take the last / away"));
            }
            None
        });
        if let Some(problem) = problem {
            self.faults.push(problem);
            return None;
        }
        self.input_files.push(path.clone());
        Some(Json::String(path.to_string_lossy().into_owned()))
    }
}

fn relative(from: &str) -> String {
    format!("relative to {from}")
}

/// The path without `.` and `x/..`, unless links make that a different file.
pub(crate) fn tidy(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let out = crate::graph::tidy(&path);
    match (path.canonicalize(), out.canonicalize()) {
        (Ok(meant), Ok(tidied)) if meant != tidied => path,
        _ => out,
    }
}
